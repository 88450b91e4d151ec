"""Reward after imitation: PPO through whole walks, for the policy that a run of `sparse` left.

config.py      settings
sparse_ppo.py  the algorithm: episodes that explore, validation on the chip within the budget
learner.py     gradient updates of policy and critic
trials.py      walks that explored, cut into windows with advantages
explore.py     exploration around a policy whose states live on
"""
