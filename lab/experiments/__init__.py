"""Experiments: many trainings and their evaluations by one command, resumed where it stopped.

A new experiment is a design, a page, and one line in EXPERIMENTS; what is trained stands in
designs.toml.

runner       the command: missing parts run as jobs, resumed where they stopped, and the page
training     a training that is found, resumed or started; a row of results that is kept
networks     a policy at a place — a chip, few bits — for a batch of robots, and what it did
costs        energies of a row, term by term
pages        pages from the Markdown of templates/, and what their tables have in common
kart         how soon networks learn to drive, and how well they do; kart_page
kart_trainings  what its trainings left, as archives
pareto       return against operations and energy; fronts, pareto_page
robustness   return under disturbances and faults
gymnasium    sparse policies on the field's own tasks
lineup       shipped policies trained again with other seeds
students     what the defaults of `distill` make of other people's teachers
eye_map      where spiking costs less, by control rate and quiet; vision, eye_costs, eye_map_page
eye_entry    kart-eye's entry test: what drives without convolutions, and what does with them
eye_trainings  what its trainings left, as archives; the files of such in archives

Other tables of results/ have a script each:

chip_policies   a policy for every chip
clocks          sparse policies by the clock of their layers
digits          scanned digits on every chip, before and after training through it
drift           the cost of quantisation
eye_events      events of kart-eye by control rate and quiet
energy_ratio    energy of spiking policies over that of float ones
hidden_neurons  shipped spiking policies with all hidden neurons dead
own_networks    networks of one's own as policies
phase_table     a table of the gait's phases as a baseline
"""

import sys
from pathlib import Path
from typing import Any

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib  # type: ignore[import-not-found, unused-ignore]

DESIGNS: dict[str, Any] = tomllib.loads(Path(__file__).with_name("designs.toml").read_text("utf-8"))
QUICK: dict[str, list[str]] = DESIGNS["quick"]  # settings of trainings of seconds
EXPERIMENTS = {
    "kart": "lab.experiments.kart:KartDesign",
    "pareto": "lab.experiments.pareto:ParetoDesign",
    "robustness": "lab.experiments.robustness:RobustnessDesign",
    "gymnasium": "lab.experiments.gymnasium:GymnasiumDesign",
    "lineup": "lab.experiments.lineup:LineupDesign",
    "students": "lab.experiments.students:StudentsDesign",
    "kart-eye-map": "lab.experiments.eye_map:EyeMapDesign",
    "kart-eye": "lab.experiments.eye_entry:EyeEntryDesign",
}
