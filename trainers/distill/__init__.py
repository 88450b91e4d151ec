"""Distillation by DAgger: a policy learns to imitate a teacher.

config.py    its settings
distill.py   the algorithm, and the student's gradient update
dagger.py    labelled states: dataset and collection
teachers.py  teachers from run folders, ONNX and NIR files
"""
