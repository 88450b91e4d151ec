"""The families of chips: a folder for each arithmetic, with its datasheets, quantiser and update.

cuba/            a synaptic current and a membrane that decay by factors.
cuba_numba/      The compiled kernels of CuBa-LIF neurons, equal to the interpreter bit for bit
cuba_numpy/      The NumPy kernels of CuBa-LIF neurons, equal to the interpreter bit for bit.
integrate_and_fire/ TrueNorth, Speck, ODIN, Spiker.
xylo/            events added one by one, states that saturate, decays by shifts.
"""
