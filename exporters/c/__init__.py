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
costs           memory, and operations in the worst case and as recorded
templates/      C with gaps
"""
