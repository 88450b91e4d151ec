"""CuBa-LIF neurons, as on Loihi: a synaptic current and a membrane that decay by factors.

bounds           Bounds: how large the numbers of a layer can get, so that fast arithmetic is p
fixed_point      The integer CuBa-LIF arithmetic of Loihi
float32          Quantisation for chips with whole weights and states in float32
free_width       Loihi's arithmetic with free widths, for exploring what a chip would need
ideal            No chip at all: the compiled path in float64, to tell compiling from rounding
loihi1           Loihi 1 (Intel, 14 nm, 2018) in the readings of three emulators
loihi2           Loihi 2 (Intel 4, 2021) with the default neuron, which computes as Loihi 1's d
quantise         Quantisation: a layer in floats becomes the integers that a chip can hold
spinnaker2       The arithmetic of chips that compute neurons in software: whole weights, state
"""
