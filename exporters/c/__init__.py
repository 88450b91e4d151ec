"""A compiled program as C99 without dependencies: the network in integers, and the codec.

The templates are C with gaps, `@NAME@`; what depends on the program is written into them.

to_c          a program and its codec as a folder of C, its self-test, memory and operations
plan          what C of a program has to know; how large its numbers get; what cannot become C
declarations  arrays of C with the narrowest types; registers and decays defined for every number
network       policy.h and policy.c: synapses, neurons, layers
codec         codec.c: observations to events, spikes and membranes to actions
int16         the interface in 16-bit integers: what its C equals bit for bit
int16_writer  codec_i16.c, host_i16.c and their self-test
int8          a float network in 8-bit weights: what its C equals bit for bit, and that C
packaging     a Zephyr module, a CMSIS layer, a cycle counter, a README
templates/    C with gaps
"""
