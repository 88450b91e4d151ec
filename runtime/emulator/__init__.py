"""The emulator: a program running, its ledger, and the controllers that drive a robot with it.

backend          The backends: what computes a program; all of them compute the same
controllers      Controllers: a policy file acting on a robot, on a chip or in float
float_machine    The float twin with the manners of a Machine: the same calls, and a ledger
interpreted      The interpreted pipeline: a program run by the interpreter; as Pipeline otherw
interpreter      The interpreter: the arithmetic of the chips as its specification, in chip tim
ledger           The ledger: what a chip did, counted, so that any table of energies can price
ledger_builder   The recorder: the ledger while it grows
machine          The machine: a chip with a program on it, running
raster           The raster: spikes of one source in a window, with counts that several readers
"""
