"""The compiled kernels of CuBa-LIF neurons, equal to the interpreter bit for bit.

arrays           A program as the arrays that the compiled kernels take
kernels          The compiled kernels: a window of a whole program in one call, equal to the in
pipeline         The native pipeline: a program in memory, run by the compiled kernels; as Pipe
"""
