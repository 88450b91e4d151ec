"""What the trainings of the kart experiment left, as archives; so that nobody need train again.

    python benchmarks/kart_trainings.py pack --runs runs/experiment-kart
    python benchmarks/kart_trainings.py unpack --runs runs/experiment-kart

`pack` writes an archive for each recipe with its complete trainings: settings, versions, counters,
metrics, episodes, the exported policies and their evaluations; no weights of critics or optimisers.
After `unpack`, `spikedeploy experiment kart` trains what is missing, and with `--no-train` it
writes the page of results/kart.md. An unpacked training cannot be resumed or exported again.
"""

import argparse
import re
import sys
from pathlib import Path
from zipfile import ZIP_DEFLATED, BadZipFile, ZipFile, ZipInfo

from spikedeploy.experiments.kart.design import ExperimentDesign
from spikedeploy.experiments.trial import Trial
from spikedeploy.files import replacing

ARCHIVES = Path(__file__).resolve().parents[1] / "results" / "kart" / "trainings"
_SCRIPTS = "scripts"  # the archive of the evaluations of built-in policies
_RUN = (
    "config.json", "versions.json", "checkpoints/last.json", "metrics.csv", "episodes.csv",
    "policy.onnx", "policy.nir", "evaluation.json", "tracks.json",
)  # fmt: skip
_NAME = re.compile(rf"kart-[\w-]+(\.json|/({'|'.join(map(re.escape, _RUN))}))")
_DATE = (2026, 1, 1, 0, 0, 0)  # of every member, so that the same files make the same archive
_MOST = 4 << 20  # [bytes] of a member


def pack(runs: Path, archives: Path) -> list[Path]:
    """Write the archives of everything that is complete; return them."""
    files = {_SCRIPTS: sorted(runs.glob("kart-*.json"))}
    for trial in ExperimentDesign(folder=str(runs)).trials():
        if trial.done:
            files.setdefault(trial.recipe, []).extend(_files(trial))
    written = {archives / f"{name}.zip": sorted(found) for name, found in files.items() if found}
    for archive, found in written.items():
        with replacing(archive) as part, ZipFile(part, "w") as zipped:
            for file in found:
                member = ZipInfo(file.relative_to(runs).as_posix(), _DATE)
                zipped.writestr(member, file.read_bytes(), ZIP_DEFLATED, compresslevel=9)
    return list(written)


def _files(trial: Trial) -> list[Path]:
    return [trial.run / name for name in _RUN if trial.run and (trial.run / name).is_file()]


def unpack(archive: Path, runs: Path) -> int:
    """Write the archive's files where there are none; return the number of those written.

    Raises BadZipFile where a member is no file of a training.
    """
    with ZipFile(archive) as zipped:
        for member in zipped.infolist():
            if not _NAME.fullmatch(member.filename) or member.file_size > _MOST:
                raise BadZipFile(f"{archive}: {member.filename!r} is no file of a training")
        names = [name for name in zipped.namelist() if not (runs / name).exists()]
        for name in names:
            with replacing(runs / name) as part:
                part.write_bytes(zipped.read(name))
    return len(names)


def main() -> int:
    """Pack or unpack, as the arguments say."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("what", choices=["pack", "unpack"])
    parser.add_argument("--runs", type=Path, required=True, help="folder of the run folders")
    parser.add_argument("--archives", type=Path, default=ARCHIVES, help="folder of the archives")
    asked = parser.parse_args()
    if asked.what == "pack":
        print(f"{len(pack(asked.runs, asked.archives))} archives in {asked.archives}")
    else:
        found = sorted(asked.archives.glob("*.zip"))
        print(f"{sum(unpack(each, asked.runs) for each in found)} files in {asked.runs}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
