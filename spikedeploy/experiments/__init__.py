"""Experiments: many trainings and their evaluations by one command.

It can be stopped at any time, and goes on where it stopped.

alone.py       one process at a time
workers.py     jobs in processes of their own, which end politely
worker.py      such a process
trial.py       one training run, exported and evaluated
drive.py       one built-in player, evaluated
finishes.py    when a training finished for the nth time
kart.py        the kart experiment: what belongs to it, and its order
kart_tables.py what its results say, as CSV and Markdown tables
kart_plot.py   the same as a picture
kart_page.py   results/kart.md

A new experiment is one file and one line in EXPERIMENTS.
"""

EXPERIMENTS = {"kart": "spikedeploy.experiments.kart:experiment"}
