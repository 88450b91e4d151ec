"""Archives of what the trainings of kart-eye left, from which others and the map go on.

    python -m lab eye-trainings pack --runs runs/kart-eye
    python -m lab eye-trainings unpack --runs runs/kart-eye
    python -m lab eye-trainings walks --runs runs/kart-eye

`pack` writes an archive for each training that ended: settings, versions, metrics, and the policy
of each level of pruning, without optimisers and walks; and one with all evaluations. After
`unpack`, `python -m lab experiment kart-eye` trains what is missing, for which it needs the walks
that trainings begin with, at each control rate: `walks` plays those again that are not there, and
takes them if they are the same to the bit.
"""

import shutil
from pathlib import Path
from tempfile import TemporaryDirectory

from lab.experiments.archives import files_left, kept_levels
from lab.experiments.eye_entry import EyeEntryDesign
from lab.experiments.training import TrainingJob, counters
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.files import replacing
from spikedeploy.trainers.run_folder import file_sha256

KEPT = kept_levels("kart-eye")


def pack(runs: Path, archives: Path) -> list[Path]:
    """Write the archives of everything that is complete; return them.

    Raises ValueError where an archive holds files that `runs` lacks; then none is written.
    """
    trainings = EyeEntryDesign(runs=str(runs)).trainings()
    return KEPT.write(runs, archives, files_left(runs, trainings))


def replay_walks(runs: Path) -> int:
    """Play common walks again into the run folders that lack them; return how many files.

    Raises ConfigError where they are not those that a run recorded, to the bit.
    """
    with TemporaryDirectory(dir=runs) as folder:
        pairs = (EyeEntryDesign(runs=str(each)).walks for each in (runs, folder))
        return sum(_replay(old, new) for old, new in zip(*pairs, strict=True) if old.run)


def _replay(recorded: TrainingJob, again: TrainingJob) -> int:
    run = recorded.existing_run
    expected = counters(run)["pool_sha256"]
    if _sums(run) == expected:
        return 0
    if not again.complete():
        raise ConfigError("interrupted: nothing was written")
    if _sums(again.existing_run) != expected:
        raise ConfigError(
            f"the walks are not those that {run} recorded, as they depend on the versions in "
            "its versions.json: install these, or train all again in another folder"
        )
    for file in sorted((again.existing_run / "pool").iterdir()):
        (run / "pool").mkdir(exist_ok=True)
        with replacing(run / "pool" / file.name) as part:
            shutil.copyfile(file, part)
    return len(expected)


def _sums(run: Path) -> list[str]:
    return [file_sha256(file) for file in sorted(run.glob("pool/*.safetensors"))]


def main() -> int:
    """Pack, unpack, or play walks again, as the arguments say."""

    def walks(runs: Path) -> str:
        return f"{replay_walks(runs)} files of walks in {runs}"

    return KEPT.command(str(__doc__).split("\n", 1)[0], pack, walks=walks)
