"""Distillation by DAgger: a policy learns to imitate a teacher.

config.py        its settings
distill.py       the algorithm, and the student's gradient update
dagger.py        labelled states: dataset and collection
teacher.py       what a teacher is, and how far a student is from its choices
teachers.py      teachers by name: run folders, NIR files, shipped policies, and what follows
onnx_teacher.py  from ONNX files, ours and anybody's
sb3_teacher.py   from Stable-Baselines3
sb3_file.py      its .zip files, read without running code
own_function.py  from Python functions
own_spaces.py    observations and actions as the author of an environment wrote them
plan.py          what the command `distill` asks for, and what came of it
"""
