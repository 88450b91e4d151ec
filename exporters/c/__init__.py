"""A compiled program as C99 without dependencies, or a float network in 8-bit weights.

The templates are C in jinja2; loops over layers and the choice of what a layer needs are in them.

to_c          a program and its codec, or a float network, as files of C; memory and operations
plan          what templates are filled with: integers of layers, types, spikes that are kept
bounds        how large the numbers of a program get
refusals      programs, codes and names that are not written in C
codec_values  numbers of encoders and decoders in doubles
int16         the interface in 16-bit integers: what its C equals bit for bit
int8          a float network in 8-bit weights: what its C equals bit for bit
declarations  numbers and arrays of C in the narrowest types; templates filled
packaging     which files there are, those around the sources, and how all are written
templates/    policy.*, rows.c, registers.c, cuba.c, integrate.c: the network;
              codec.c, encode_*.c, decode.c: observation to action; *_i16: in 16 bits;
              dense_*: 8-bit weights; selftest*, run_*: self-tests; the rest stands around
"""
