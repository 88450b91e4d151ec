"""Proximal policy optimisation, for discrete and continuous actions: on-policy.

config.py    its settings
ppo.py       the algorithm
learner.py   policy, action distributions, critic and their gradient updates
batch.py     batches and advantages
episodes.py  logs of training episodes: CSV file and ghosts
"""
