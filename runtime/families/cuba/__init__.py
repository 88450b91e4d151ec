"""CuBa-LIF neurons, as on Loihi: a synaptic current and a membrane that decay by factors.

`neurons` is the specification; the kernels in cuba_numpy and cuba_numba are tested to equal it.

neurons          the registers in integers, and one timestep, with and without registers
fixed_point      the integer arithmetic of Loihi
free_width       the same with free widths: the chip `int`
floating_point   float64 and float32 arithmetic: the chips `ideal` and `spinnaker2`
quantise         a layer in floats becomes the integers that registers hold
readouts         the scale of a layer without a threshold, and what its registers hold
bounds           how large the numbers of a layer can get, and scales at which none overflows
loihi            the datasheets of Loihi 1, by three published models, and of Loihi 2
loihi_traces     recorded runs of Loihi, as lava, brian2_loihi, nengo-loihi and boards write them
"""
