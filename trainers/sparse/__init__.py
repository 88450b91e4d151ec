"""Sparse policies: a teacher imitated through whole walks by students that are pruned in rounds.

config.py    settings
budget.py    the budget as the command line takes it
sparse.py    the algorithm: walks, phases, validation on the chip
phases.py    dense, levels of pruning, polish
rounding.py  what the chip makes of the weights, for training with rounding
learner.py   gradient updates and pruning of a student
students.py  what the algorithm asks of a spiking and of a float student
pruning.py   one ranking over all synapses by what they are worth for an operation
steps.py     steps of the delta encoder
pool.py      whole walks, their events, and windows of them
pool_files.py  walks of a run on disk, and those of another run
collect.py   episodes, several at once
on_chip.py   students as controllers, in float and on the chip
"""
