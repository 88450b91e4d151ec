"""Soft actor-critic, for continuous actions: off-policy, from a replay buffer.

sac.py      a run of the algorithm, and the shaping of its reward
learner.py  settings, replay buffer, networks and their gradient update
cuda.py     the gradient update on a GPU
"""
