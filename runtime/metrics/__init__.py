"""Metrics: energy, time, memory, messages and NeuroBench's numbers of a run.

energy           Energy and time: what the events of a ledger cost, by tables of which each say
energy_tables    The energy tables that are known, and the static power of chips
memory           Memory: what a chip reads and writes for the events of a ledger, in bits
neurobench       NeuroBench's numbers, by its own names and formulas: what its release 2.3.0 ma
traffic          Traffic: the messages that spikes become on a chip of many cores, and how far
xylo_clocks      How long Xylo takes: clocks of its core in a timestep, by rockpool's model of
"""
