"""Sparse policies: a teacher imitated through whole walks by students that are pruned in rounds.

walks.py              whole walks: collected, in checkpoints, their events, and windows of them
settings.py           settings
phases.py             phases of a training: planned for a budget, or found one after another
student.py            what learns and is pruned: its loss, its synapses, its numbers on the chip
delta_encoder.py      steps of the encoder and thresholds, by what walks show
rounding.py           numbers of a policy as the chip rounds them
pruning.py            synapses ranked by what they are worth for each operation
batch_controllers.py  students in episodes: in float, on the chip, and what they count
sparse.py             the algorithm: budget, walks, pruning, validation on the chip
sparse_ppo.py         reward after imitation: PPO on windows of whole walks
"""
