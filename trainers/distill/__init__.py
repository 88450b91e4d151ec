"""Distillation by DAgger: a policy learns to imitate a teacher.

distill.py   settings, labelled states, the algorithm
teacher.py   what a teacher is, and an environment's observations and actions as its author has them
teachers.py  teachers by name: run folders, NIR and ONNX files, functions, shipped policies
sb3.py       from Stable-Baselines3, read without running code
"""
