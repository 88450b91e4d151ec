"""The families of chips: a folder for each arithmetic, with its datasheets, quantiser and update.

Nothing outside imports them: the table runtime.chips.CHIPS says where a chip stands, and its
arithmetic names the backends that can run it. A new family is a folder here and a line there.

cuba                  CuBa-LIF neurons: Loihi 1 and 2, SpiNNaker2, free widths, and no chip at all
xylo                  Xylo: events one by one, states that saturate, decays by shifts
integrate_and_fire    no synaptic current: TrueNorth, Speck, ODIN, tinyODIN, Spiker
program_record        programs of all of them as plain numbers, under the names of chips' tools
program_traces        recorded runs of such programs
cuba_numpy            NumPy kernels of cuba
cuba_numba            compiled kernels of cuba

The kernels equal the update bit for bit on chips with integers; on `ideal`, which computes in
float64, up to its rounding. The classes of datasheets are in runtime/chips, the datasheets here.
"""
