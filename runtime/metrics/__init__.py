"""Metrics of a recorded run: energy, time, memory, messages, and those of NeuroBench.

All of them are computed after a run, from its ledger or spikes, so that any run can be costed again
by another table.

energy_tables    the tables, with source and uncertainty, and static power of chips
energy           energy and time of a ledger by a table, term by term; break-even; Xylo's clocks
traffic          bits read and written, messages between cores, what the host computes
neurobench       NeuroBench's metrics by its own formulas
"""
