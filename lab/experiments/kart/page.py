"""The page of the kart experiment: results/kart.md, its tables as CSV, and its picture."""

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from lab.experiments.kart.design import (
    CLASSIC,
    CORRIDOR,
    COUNT,
    DEFAULT,
    GREEDY,
    LEARNING,
    PRESETS,
    ExperimentDesign,
    preset_of,
)
from lab.experiments.kart.heldout import UNSEEN
from lab.experiments.kart.heldout_table import heldout_table
from lab.experiments.kart.plot import finishes_figure
from lab.experiments.kart.records import Record, driving, heldout, learning, write_csv
from lab.experiments.kart.tables import chip_table, driving_table, learning_table
from lab.experiments.kart.verdicts import (
    chip_verdicts,
    heldout_verdicts,
    learning_verdicts,
)
from lab.experiments.parts import command_line
from lab.experiments.trial import Trial
from spikedeploy.files import read_json
from spikedeploy.reports.page import write_beside
from spikedeploy.reports.plots import save
from spikedeploy.trainers.ppo import HOLDS
from spikedeploy.trainers.versions import began_with, own

_PICTURE = "kart/finishes.png"


def write(design: ExperimentDesign, results: Path) -> list[Path]:
    """Write page, tables and picture of the complete parts; return the files."""
    learned, driven, tracks = learning(design), driving(design), heldout(design)
    folder = results / "kart"
    files = [
        write_csv(learned, folder / "learning.csv"),
        write_csv(driven, folder / "driving.csv"),
        write_csv(tracks, folder / "tracks.csv"),
        write_csv(_finishes(design), folder / "finishes.csv"),
        save(drawn := finishes_figure(design), folder / "finishes.png"),
    ]
    text = _page(design, learned, driven, tracks)
    page, shown = write_beside(results / "kart.md", text, {_PICTURE: drawn})
    return [page, *files, shown]


def _finishes(design: ExperimentDesign) -> list[Record]:
    """One row for each finish of each complete training, up to COUNT."""
    return [
        {"recipe": t.recipe, "seed": t.seed, "finish": n, "env_steps": steps}
        for t in design.trials()
        if t.trained and preset_of(t) in LEARNING
        for n, steps in enumerate(map(int, t.finishes[:COUNT]), start=1)
    ]


_ARCHIVES = """\
This trains what the run folders in `{folder}` do not hold, or with `--no-train` leaves it out. What
the trainings of this project left is kept in results/kart/trainings; before the command above,
`python -m lab kart-trainings unpack --runs {folder}` puts it there."""
_SHARES = """\
In steps, the SNN's share of the ANN is the ANN's steps over the SNN's: above 100% it is sooner."""
_LEARNING = f"""\
Environment steps, those of all copies of the world together; medians over the training seeds
[least, most]. A training that ended without counts with all the steps it took, and what it could
raise has a ">". Two metrics:

- the first and the {COUNT}th finished episode of training, whose actions are drawn and whose starts
  are random. It is kart-simulator's own, and mostly counts laps once a policy finishes at all;
- greedy {GREEDY:.0%}: the first validation (20 greedy episodes, every 10,000 steps, seeds 5,000 to
  5,019) in which {GREEDY:.0%} finish, if the next one says so, too, or if there is none.

"% of ANN" is the ANN's steps over those of the policy (more is sooner), with a 95% bootstrap
interval over training seeds. Where some trainings of one did not get there, they count with all the
steps they took, which bounds the share from below (≥) or from above (≤), and of its interval the
lower or the upper end; "–" where some of both did not. kart-simulator's figures are of single, best
runs, read off once a batch."""
_PRESETS = {
    DEFAULT: """\
Dynamics, track, starts and what counts as a finish are kart-simulator's; the reward, the
observation (rays straight ahead, all of the motion) and PPO's settings are ours. So the steps show
what a user of this project gets, not which of these differences is worth how much.""",
    CLASSIC: """\
kart-simulator's observation, reward, terminations, networks and settings of PPO; what still differs
is listed in [docs/karts.md](../docs/karts.md). A training that ends early, as said at the end of
this page, was not watched for greedy driving any longer than that.""",
    CORRIDOR: """\
Corridors of eight cells, drawn anew in each episode, in training, validation and evaluation; the
default settings, without a position among the observations.""",
}
_DRIVING = """\
Greedy episodes from {episodes} starts that no training saw, for the best checkpoint by validation
of each training; medians over the trainings [least, most]. `float` is the float twin of the spiking
network, `{chip}` the same file in the emulated chip's integers. Controls: `small` is a float
network of the spiking one's size, `linear` has no hidden layer; both learn by the same rules within
the same budget. `gap` is a script that follows the gap in the LIDAR, `random` draws its actions.
MACs are those whose input is not 0; energies price every MAC of the dense networks, and ≥ is a
[lower bound](../docs/energy.md#how-to-read-them) for hardware that executes them all."""
_CHIP = """\
The same starts, the same file; points of the finish rate, and the share of equal actions on the
observations that the twin recorded."""
_TRACKS = f"""\
The share of starts that finish, greedily, on tracks that a policy was not trained on, with a 95%
interval over trainings and starts (of a script, and where all trainings agree in every start:
Wilson's, over starts). `corridor-8` policies learned in corridors of eight cells that are drawn
anew in each episode, and observe only LIDAR and velocity; their starts here draw corridors that no
training saw. `big_S` policies are those of the default preset. Spiking policies run on the chip.
Trained on neither: {", ".join(UNSEEN)}. Parameters of `gap` were tuned on big_S."""


def _page(
    design: ExperimentDesign,
    learned: Sequence[Record],
    driven: Sequence[Record],
    tracks: Sequence[Record],
) -> str:
    """The page."""
    parts = ["# Karts: float and spiking networks, learned from scratch", f"    {command_line()}"]
    parts += [_ARCHIVES.format(folder=design.folder), *_missing(design)]
    said = [*learning_verdicts(learned), *chip_verdicts(driven), *heldout_verdicts(tracks)]
    parts += [_SHARES, "\n".join(said), "## How soon they finish", _LEARNING]
    parts += [f"![finishes against environment steps]({_PICTURE})"]
    for preset in PRESETS:
        own = [row for row in learned if row["preset"] == preset]
        parts += [f"### {preset} preset", _PRESETS[preset], "\n".join(learning_table(own))]
    parts += ["## How well they drive", _DRIVING.format(**vars(design))]
    for preset in PRESETS:
        own = [row for row in driven if row["preset"] == preset]
        parts += [f"### {preset} preset, driving", "\n".join(driving_table(own))]
    parts += ["## The chip beside its float twin", _CHIP]
    for preset in PRESETS:
        own = [row for row in driven if row["preset"] == preset]
        parts += [f"### {preset} preset, on the chip", "\n".join(chip_table(own))]
    parts += ["## Tracks that were not trained on", _TRACKS, "\n".join(heldout_table(tracks))]
    parts += ["## How this was made", "\n".join(_facts(design))]
    return "\n\n".join(part for part in parts if part) + "\n"


def _missing(design: ExperimentDesign) -> list[str]:
    """How many parts are complete, and of what trainings are not; empty where all are."""
    done, of_all = sum(part.done for part in design.parts), len(design.parts)
    if done == of_all:
        return []
    left = Counter(
        f"{preset_of(trial)} {trial.recipe.rpartition('-')[2]}"
        for trial in design.trials()
        if not trial.done
    )
    text = f"**{done} of {of_all} parts are complete.**"
    missing = ", ".join(f"{name} {count}" for name, count in left.items())
    return [f"{text} Trainings that are missing: {missing}." if left else text]


def _facts(design: ExperimentDesign) -> list[str]:
    """What is needed to reproduce the experiment."""
    trained = design.trials()
    return [
        f"- spikedeploy {own()}; run folders in `{design.folder}`",
        f"- training seeds asked for: 0 to {design.seeds - 1}; of controls 0 to "
        f"{design.controls - 1}",
        *(_end(trained, preset) for preset in PRESETS),
        *_begun_with(trained),
        *(f"- `--set {setting}`" for setting in design.overrides),
        *(
            f"- ✗ {trial.name} was trained with other settings than its recipe has now: "
            + ", ".join(trial.changed_settings)
            for trial in trained
            if trial.changed_settings
        ),
        "- every number: [learning.csv](kart/learning.csv), [driving.csv](kart/driving.csv), "
        "[tracks.csv](kart/tracks.csv), [finishes.csv](kart/finishes.csv)",
    ]


def _begun_with(trials: Sequence[Trial]) -> list[str]:
    """Versions when trainings began, and of how many; the most frequent first."""
    files = [trial.run / "versions.json" for trial in trials if trial.run and trial.trained]
    return began_with(read_json(file) for file in files if file.is_file())


def _end(trials: Sequence[Trial], preset: str) -> str:
    """When the trainings of a preset end."""
    own = [trial for trial in trials if preset_of(trial) == preset]
    configs = {trial.config.env.name: trial.config for trial in own}
    budgets = ", ".join(f"{config.steps:,} ({world})" for world, config in configs.items())
    config = own[0].config
    limits = []
    if config.stop_at_finishes:
        limits.append(f"{config.stop_at_finishes} finishes")
    if config.stop_at_greedy:
        limits.append(f"{HOLDS} validations in a row of greedy {config.stop_at_greedy:.0%}")
    early = f" {' and '.join(limits)}, or" if limits else ""
    return f"- {preset}: a training ends with{early} its budget of environment steps: {budgets}"
