"""Soft actor-critic, for continuous actions: off-policy, from a replay buffer.

config.py   its settings
sac.py      a run of the algorithm
learner.py  its networks and their gradient update
cuda.py     the gradient update on a GPU
replay.py   replay buffer
shaping.py  the reward that updates see, where it differs from the environment's
"""
