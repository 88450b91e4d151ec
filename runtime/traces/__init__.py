"""Traces: recorded runs of other emulators or boards, replayed and compared.

verify     a trace file and the verdict on it
verdict    what a recorded run is, its replay, and the first number that differs
fields     a JSON object read by name
layered    runs of layers: Loihi's emulators and boards, xylosim, Spiker+'s RTL
crossbar   ODIN and tinyODIN, event by event
speck      networks for Speck, in timesteps and event by event
sanafe     counts and energies of SANA-FE, against our ledger
programs   exported programs as plain numbers, and their recorded runs
"""
