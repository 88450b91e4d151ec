"""Reward after imitation: PPO through whole walks, for the policies that runs of `sparse` left.

config.py      settings
sparse_ppo.py  the algorithm: episodes that explore, validation on the chip within the budget
start.py       the run that it goes on from
learner.py     gradient updates of policy and critic
trials.py      walks that explored, cut into windows with advantages
replay.py      policies whose walks are played again in windows, spiking and float
explore.py     exploration: distributions, and a controller that records what it drew
"""
