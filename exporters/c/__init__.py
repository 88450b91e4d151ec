"""A compiled program as C99 without dependencies: the network in integers, and the codec.

The templates are C with gaps, `@NAME@`; what depends on the program is written into them.

to_c            a program and its codec as a folder of C
refusals        what cannot become C, and what to do instead
declarations    arrays of C with the narrowest types, and the memory that they take
magnitudes      how large the numbers of a layer can get: which integers of C hold them
registers       registers and decays of a chip as C that is defined for every number
plan            what of a program its C has to know: names, types, spikes that are kept
network         policy.h and policy.c: layers, one timestep after another
layers          the functions of a layer
synapses        the synapses of a projection: rows of weights
cuba            one timestep of CuBa-LIF neurons
integrate       one timestep of integrate-and-fire neurons
encoders        codec.c: observations to events
fixed_parts     the delta code in fixed point, and how sure its rounding is
decoder         codec.c: spikes and membranes to actions
vectors         what the interpreter computes, for the self-test
int16_interface observations as 16-bit integers: a power of two for each
int16_codec     the codec in 16-bit integers: what its C equals bit for bit
int16_tanh      tanh from a fixed-point score to Q15
int16_writer    codec_i16.c, host_i16.c and their self-test
int8_mlp        a float network in 8-bit weights: what its C equals bit for bit
int8_writer     policy.c of such a network
packaging       a Zephyr module, a CMSIS layer, a cycle counter, a README
costs           memory, and operations in the worst case and as recorded
templates/      C with gaps
"""
