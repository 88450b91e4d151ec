"""The compiler: whether a network fits on a chip, and the program that it becomes there.

The parts that differ between arithmetics are the chip's; this package holds the common ones.

lowering  populations and the projections between them, counted for the rules
synapses  the weights of projections, as kernels with their windows or as matrices
mapping   populations on cores, and the utilisation of the cores
rules     the design rules, and what they found in a network
outliers  layers that one large number makes coarse, and what helps
compile   the compiler itself, and the check of every design rule without an error
program   the result: a network as one chip runs it
"""
