"""The families of chips: for each arithmetic its update, its quantiser and its kernels.

The compiler and the emulator import none of them: the table runtime.chips.ARITHMETICS gives the
module of an arithmetic, which names the backends that can run it. What is made for one family, such
as its traces, its C or its training, imports it. A new family is a file or a folder here.

cuba                  CuBa-LIF neurons: Loihi 1 and 2, SpiNNaker2, free widths, and no chip at all
xylo                  Xylo: events one by one, states that saturate, decays by shifts
numba_xylo            its compiled kernel
numba_frame           the compiled frame of all families; numba_pipeline is its backend
integrate_and_fire    no synaptic current: TrueNorth, Speck, ODIN, tinyODIN, Spiker
"""
