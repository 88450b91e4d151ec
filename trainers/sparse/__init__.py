"""Sparse policies: a teacher imitated through whole walks by students that are pruned in rounds.

sparse.py   the algorithm: walks, phases, pruning, validation on the chip
student.py  loss of a student, its synapses ranked, rounded and run as the chip runs them
pool.py     whole walks: collected, on disk, their events, and windows of them
config.py   settings, phases, and the budget as the command line takes it
ppo.py      reward after imitation: PPO on windows of whole walks
"""
