"""Experiments: many trainings and their evaluations by one command, resumed where it stopped.

A new experiment is a design, what runs it, and one line in EXPERIMENTS.

trial         one training run, exported and evaluated
evaluation    greedy episodes of a policy on evaluation seeds
finishes      environment steps at which training episodes finished
parts         missing parts run as jobs, reported, and the page of what is there
stored_row    a row of results that is kept until what made it changes
command       the command line of all experiments
kart          the kart experiment: how soon networks learn to drive, and how well they do
pareto        the pareto experiment: return against operations and energy
robustness    the robustness experiment: return under disturbances and faults
gymnasium     the gymnasium experiment: sparse policies on the field's own tasks
lineup        the lineup experiment: shipped policies trained again with other seeds

Other tables of results/ have a script each:

chip_policies   a policy for every chip
clocks          sparse policies by the clock of their layers
drift           what quantisation costs; its page is in drift_page
energy_ratio    energy of spiking policies over that of float ones
phase_table     a table of the gait's phases as a baseline
"""

# what runs it, and what makes its design of the options that were given
EXPERIMENTS = {
    "kart": (
        "lab.experiments.kart.experiment:experiment",
        "lab.experiments.kart.design:asked",
    ),
    "pareto": (
        "lab.experiments.pareto.experiment:experiment",
        "lab.experiments.pareto.design:asked",
    ),
    "robustness": (
        "lab.experiments.robustness.experiment:experiment",
        "lab.experiments.robustness.design:asked",
    ),
    "gymnasium": (
        "lab.experiments.gymnasium.experiment:experiment",
        "lab.experiments.gymnasium.design:asked",
    ),
    "lineup": (
        "lab.experiments.lineup.experiment:experiment",
        "lab.experiments.lineup.design:asked",
    ),
}
