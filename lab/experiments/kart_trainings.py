"""Archives of what the trainings of the kart experiment left, so that no one trains again.

    python -m lab kart-trainings pack --runs runs/experiment-kart
    python -m lab kart-trainings unpack --runs runs/experiment-kart

`pack` writes an archive for each recipe with its complete trainings: settings, versions, counters,
metrics, episodes, the exported policies and their evaluations; no weights of critics or optimisers.
After `unpack`, `python -m lab experiment kart` trains what is missing, and with `--no-train` it
writes the page of results/kart.md. An unpacked training cannot be resumed or exported again.
"""

import re
from pathlib import Path

from lab.experiments.archives import RESULTS, Kept
from lab.experiments.kart import KartDesign, KartTraining

_SCRIPTS = "scripts"  # the archive of the evaluations of built-in policies
_ENDS = ("", "-tracks")  # of their names
_RUN = (
    "config.json", "versions.json", "checkpoints/last.json", "metrics.csv", "episodes.csv",
    "policy.onnx", "policy.nir", "evaluation.json", "tracks.json",
)  # fmt: skip
_NAME = re.compile(rf"kart-[\w-]+(\.json|/({'|'.join(map(re.escape, _RUN))}))")
# a training counts as complete by its evaluation, which must not come before the rest
KEPT = Kept(RESULTS / "kart" / "trainings", _NAME, 4 << 20, ("evaluation.json", "tracks.json"))
unpack = KEPT.unpack


def pack(runs: Path, archives: Path) -> list[Path]:
    """Write the archives of everything that is complete; return them.

    Raises ValueError where an archive holds files that `runs` lacks; then none is written.
    """
    design = KartDesign(runs=str(runs))
    scripts = (runs / f"{part.name}{end}.json" for part in design.scripts() for end in _ENDS)
    files = {_SCRIPTS: [file for file in scripts if file.is_file()]}
    for trial in design.trainings():
        if trial.evaluation is not None:
            files.setdefault(trial.recipe, []).extend(_files(trial))
    return KEPT.write(runs, archives, files)


def _files(trial: KartTraining) -> list[Path]:
    return [trial.run / name for name in _RUN if trial.run and (trial.run / name).is_file()]


def main() -> int:
    """Pack or unpack, as the arguments say."""
    return KEPT.command(str(__doc__).split("\n", 1)[0], pack)
