"""The compiler: an artifact becomes the program of a chip.

check            The check: what every design rule of a chip says of a network, the compiler in
compile          The compiler: an artifact becomes the program of a chip
linear           All between spikes as matrices: chains of weights, windows, sums and delays, o
program          The program: a network as one chip runs it; compiled, frozen, and all that a M
quantisation     How a float network becomes integers: which neurons share a scale, rounding, h
quantise         Float layers as the numbers of a chip, whatever its arithmetic is
wiring           The wiring of a graph: which spiking node hears which, and in what order they
"""
