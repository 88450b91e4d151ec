"""Sparse policies: a teacher imitated through whole walks by students that are pruned in rounds.

pool.py         whole walks: collected, on disk, their events, and windows of them
config.py       settings
phases.py       phases of a training: planned for a budget, or found one after another
student.py      loss of a student, its synapses ranked and rounded as the chip has them
controllers.py  students in episodes: in float, on the chip, and what they count
sparse.py       the algorithm: budget, walks, pruning, validation on the chip
ppo.py          reward after imitation: PPO on windows of whole walks
"""
