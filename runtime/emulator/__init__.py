"""The emulator: a program running, its ledger, and the controllers that drive a robot with it.

backend             what computes a program: one Protocol, and the choice
controllers         a policy file acting on a robot, on a chip or in float
float_machine       the float twin with the calls of a Machine
host                what the host makes of what leaves a chip; readouts that it integrates
interpreter         the arithmetic of the chips as its specification, in chip time
interpreter_backend the interpreter as a backend
upset_backend       the same on a chip with lost and spurious spikes and flipped bits of membranes
ledger              what a chip did, counted, so that any table of energies can price it
machine             a chip with a program on it, running
network             a network on a chip or in float: the one place that decides
"""
