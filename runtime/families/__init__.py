"""The families of chips: a folder for each arithmetic, with its datasheets, quantiser and update.

Nothing outside imports them: the table runtime.chips.CHIPS says where a chip stands, and its
arithmetic which backends can run it. A new family is a folder here and a line in that table.

cuba                  CuBa-LIF neurons: Loihi 1 and 2, SpiNNaker2, free widths, and no chip at all
xylo                  Xylo: events one by one, states that saturate, decays by shifts
integrate_and_fire    no synaptic current: TrueNorth, Speck, ODIN, Spiker
cuba_numpy            NumPy kernels of cuba, equal to its update bit for bit
cuba_numba            compiled kernels of cuba, equal to its update bit for bit
"""
