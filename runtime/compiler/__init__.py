"""The compiler: an artifact becomes the program of a chip.

What differs between arithmetics it asks of the chip; here is what all have in common.

compile          the compiler itself, and the check of every design rule without an error
wiring           which spiking node is connected to which, as matrices, and in what order they run
linear           everything between spikes as matrices, one for each lag
program          the result: a network as one chip runs it
"""
