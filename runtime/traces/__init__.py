"""Traces: recorded runs of other emulators or boards, replayed and compared.

The readers of each family's traces stand in its folder; here is what all have in common.

verify           a trace file, its replay on our arithmetic, and the first number that differs
sanafe           counts and energies of SANA-FE, against our ledger
fields           a JSON object read by name, and how much a replay may compute
"""
