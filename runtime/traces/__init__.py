"""Traces: recorded runs of other emulators or boards, replayed and compared.

The readers of each family's traces stand in its folder; here is what all have in common.

verify           a recorded run once more on our arithmetic, and the first number that differs
trace_file       the format, who wrote a file, and verdicts
work             how much a replay computes, and the most that is replayed
fields           a JSON object read by name, with errors that name the field
sanafe           SANA-FE's counts and energies of a network, compared with the ledger's
"""
