"""Metrics of a recorded run: energy, time, memory, messages, and those of NeuroBench.

All of them are computed after a run, from its ledger or spikes, so that any run can be costed again
by another table.

break_even       below which spike rate, or how many operations, spiking costs less
energy           energy and time of a ledger by a table
energy_terms     where the energy goes: terms of the chip and of the host
energy_tables    the tables, with source and uncertainty, and static power of chips
host_work        what the host computes for readouts
memory           bits read and written
neurobench       NeuroBench's metrics by its own formulas
traffic          messages between cores under a layout
xylo_clocks      clock cycles of a Xylo
"""
