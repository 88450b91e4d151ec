"""The families of chips: for each arithmetic its update, its quantiser and its kernels.

Nothing outside imports them: the table runtime.chips.CHIPS gives the module of a chip, and its
arithmetic names the backends that can run it. A new family is a file or a folder here.

cuba                  CuBa-LIF neurons: Loihi 1 and 2, SpiNNaker2, free widths, and no chip at all
xylo                  Xylo: events one by one, states that saturate, decays by shifts
numba_xylo            its compiled kernel
numba_frame           the compiled frame of all families; numba_pipeline is its backend
integrate_and_fire    no synaptic current: TrueNorth, Speck, ODIN, tinyODIN, Spiker
"""
