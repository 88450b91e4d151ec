"""Archives of what the trainings of the kart experiment left, so that no one trains again.

    python -m lab kart-trainings pack --runs runs/experiment-kart
    python -m lab kart-trainings unpack --runs runs/experiment-kart

`pack` writes an archive for each recipe with its complete trainings: settings, versions, counters,
metrics, episodes, the exported policies and their evaluations; no weights of critics or optimisers.
After `unpack`, `python -m lab experiment kart` trains what is missing, and with `--no-train` it
writes the page of results/kart.md. An unpacked training cannot be resumed or exported again.
"""

import argparse
import re
import sys
import zlib
from pathlib import Path
from zipfile import ZIP_DEFLATED, BadZipFile, ZipFile, ZipInfo

from lab.experiments.kart import KartDesign, KartTraining
from spikedeploy.files import replacing

ARCHIVES = Path(__file__).resolve().parents[2] / "results" / "kart" / "trainings"
_SCRIPTS = "scripts"  # the archive of the evaluations of built-in policies
_ENDS = ("", "-tracks")  # of their names
_RUN = (
    "config.json", "versions.json", "checkpoints/last.json", "metrics.csv", "episodes.csv",
    "policy.onnx", "policy.nir", "evaluation.json", "tracks.json",
)  # fmt: skip
_NAME = re.compile(rf"kart-[\w-]+(\.json|/({'|'.join(map(re.escape, _RUN))}))")
_DATE = (2026, 1, 1, 0, 0, 0)  # of every member, so that the same files make the same archive
_MOST = 4 << 20  # [bytes] of a member


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
    written = {archives / f"{name}.zip": sorted(found) for name, found in files.items() if found}
    for archive, found in written.items():
        _check_kept(archive, {file.relative_to(runs).as_posix() for file in found})
    for archive, found in written.items():
        with replacing(archive) as part, ZipFile(part, "w") as zipped:
            for file in found:
                member = ZipInfo(file.relative_to(runs).as_posix(), _DATE)
                zipped.writestr(member, file.read_bytes(), ZIP_DEFLATED, compresslevel=9)
    return list(written)


def _files(trial: KartTraining) -> list[Path]:
    return [trial.run / name for name in _RUN if trial.run and (trial.run / name).is_file()]


def _check_kept(archive: Path, names: set[str]) -> None:
    """Refuse to write an archive anew without what it holds: it was not trained again."""
    if not archive.is_file():
        return
    with ZipFile(archive) as zipped:
        lost = set(zipped.namelist()) - names
    if lost:
        raise ValueError(f"{archive} holds {min(lost)}, which --runs lacks: unpack it there first")


def unpack(archive: Path, runs: Path) -> int:
    """Write the archive's files where there are none; return the number of those written.

    Raises BadZipFile where a member is no file of a training.
    """
    with ZipFile(archive) as zipped:
        content = {member.filename: _read(zipped, member) for member in zipped.infolist()}
    missing = [name for name in content if not (runs / name).exists()]
    # a training counts as complete by its evaluation, which must not come before the rest
    for name in sorted(missing, key=lambda name: name.endswith(("evaluation.json", "tracks.json"))):
        with replacing(runs / name) as part:
            part.write_bytes(content[name])
    return len(missing)


def _read(zipped: ZipFile, member: ZipInfo) -> bytes:
    """The content of a member; BadZipFile where it is no file of a training, or too large."""
    if not _NAME.fullmatch(member.filename) or member.file_size > _MOST:
        raise BadZipFile(f"{zipped.filename}: {member.filename!r} is no file of a training")
    return zipped.read(member)


def main() -> int:
    """Pack or unpack, as the arguments say."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("what", choices=["pack", "unpack"])
    parser.add_argument("--runs", type=Path, required=True, help="folder of the run folders")
    parser.add_argument("--archives", type=Path, default=ARCHIVES, help="folder of the archives")
    options = parser.parse_args()
    try:
        print(_run(options))
    except (OSError, ValueError, RuntimeError, BadZipFile, zlib.error) as error:
        sys.exit(f"error: {error}")
    return 0


def _run(options: argparse.Namespace) -> str:
    if options.what == "pack":
        written = pack(options.runs, options.archives)
        if not written:
            raise ValueError(f"{options.runs} has no complete training or evaluation")
        return f"{len(written)} archives in {options.archives}"
    found = sorted(options.archives.glob("*.zip"))
    if not found:
        raise ValueError(f"{options.archives} has no archives")
    return f"{sum(unpack(each, options.runs) for each in found)} files written into {options.runs}"
