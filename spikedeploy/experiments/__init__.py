"""Experiments: many trainings and their evaluations by one command, resumed where it stopped.

A new experiment is a design, what runs it, and one line in EXPERIMENTS.

trial         one training run, exported and evaluated
evaluation    greedy episodes of a policy on evaluation seeds
finishes      environment steps at which training episodes finished
workers       jobs in processes of their own, some at a time
worker        the program that such a process runs
training_seeds  one recipe with several seeds, side by side
parts         missing parts run as jobs, reported, and the page of what is there
stored_row    a row of results that is kept until what made it changes
csv_rows      rows of results as CSV, and read again
kart          the kart experiment: how soon networks learn to drive, and how well they do
pareto        the pareto experiment: return against operations and energy
robustness    the robustness experiment: return under disturbances and faults
gymnasium     the gymnasium experiment: sparse policies on the field's own tasks
lineup        the lineup experiment: shipped policies trained again with other seeds
"""

# what runs it, and what makes its design of the options that were given
EXPERIMENTS = {
    "kart": (
        "spikedeploy.experiments.kart.experiment:experiment",
        "spikedeploy.experiments.kart.design:asked",
    ),
    "pareto": (
        "spikedeploy.experiments.pareto.experiment:experiment",
        "spikedeploy.experiments.pareto.design:asked",
    ),
    "robustness": (
        "spikedeploy.experiments.robustness.experiment:experiment",
        "spikedeploy.experiments.robustness.design:asked",
    ),
    "gymnasium": (
        "spikedeploy.experiments.gymnasium.experiment:experiment",
        "spikedeploy.experiments.gymnasium.design:asked",
    ),
    "lineup": (
        "spikedeploy.experiments.lineup.experiment:experiment",
        "spikedeploy.experiments.lineup.design:asked",
    ),
}
