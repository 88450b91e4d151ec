"""CuBa-LIF neurons, as on Loihi: a synaptic current and a membrane that decay by factors.

`neurons` is the specification. The kernels are tested to equal it bit for bit on chips with
integers and in float32, and up to float64 rounding on `ideal`.

neurons          the registers in integers, and one timestep, with and without registers
quantise         a layer in floats becomes integers; bounds on what registers must hold
arithmetic       the arithmetics: Loihi's integers, free widths, float64 and float32
numpy_backend    the NumPy kernels: the window of a layer in few calls; their backend
numba_kernels    the compiled kernels: a window of a whole program in one call
numba_backend    the numbers of a program for them; their backend
numba_float      compiled kernels and backend of layers in float32
traces           recorded runs of Loihi, as lava, brian2_loihi, nengo-loihi and boards write them
"""
