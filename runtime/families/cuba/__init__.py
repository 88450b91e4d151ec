"""CuBa-LIF neurons, as on Loihi: a synaptic current and a membrane that decay by factors.

`neurons` is the specification. The kernels are tested to equal it bit for bit on chips with
integers and in float32, and up to float64 rounding on `ideal`.

neurons          the registers in integers, and one timestep, with and without registers
quantise         a layer in floats becomes integers; bounds on what registers must hold
arithmetic       the arithmetics: Loihi's integers, free widths, float64 and float32
numpy_backend    the NumPy kernels: the window of a layer in few calls; their backend
numba_steps      the compiled step and backends of layers with integers and in float32
"""
