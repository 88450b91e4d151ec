"""Soft actor-critic, for continuous actions: off-policy, from a replay buffer.

config.py   its settings
sac.py      the algorithm
learner.py  actor, critics and their gradient update
replay.py   replay buffer
"""
