"""The kart experiment: networks from scratch in three worlds, as ours and as kart-simulator's.

experiment     which parts are missing, done in order, with progress
design         its trainings and controls, and kart-simulator's own figures
heldout        greedy episodes of a driver on every track
records        its results as records and CSV
tables         learning, driving and the chip as Markdown tables
heldout_table  finish shares on held-out tracks, with their intervals
verdicts       its sentences: each target, and whether it was reached
plot           finishes against environment steps
page           results/kart.md
"""
