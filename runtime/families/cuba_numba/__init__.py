"""The compiled kernels of CuBa-LIF neurons.

Equal to the interpreter bit for bit on chips with integers; on `ideal` up to float64 rounding.

arrays           a program, and the memory that it runs in, as the arrays that kernels take
jit              how the kernels are compiled, and kept on disk
kernels          a window of a whole program in one call
layout           array layout of the kernels
neurons          the update of neurons in one timestep, in float64 and in int64
pipeline         the backend
spikes           spikes listed once for each row, summed up as weights, and counted
"""
