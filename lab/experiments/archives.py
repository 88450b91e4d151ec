"""Archives of files that trainings left: the same files make the same archive; unpacked with care.

python -m lab kart-trainings pack --runs runs/experiment-kart
python -m lab eye-trainings unpack --runs runs/kart-eye
"""

import argparse
import lzma
import re
import sys
import zlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from zipfile import ZIP_DEFLATED, BadZipFile, ZipFile, ZipInfo

from lab.experiments.training import TrainingJob
from spikedeploy.runtime.files import replacing
from spikedeploy.trainers.run_folder import LEVEL

RESULTS = Path(__file__).resolve().parents[2] / "results"
Pack = Callable[[Path, Path], Iterable[Path]]
_DAMAGED = (BadZipFile, EOFError, NotImplementedError, zlib.error, lzma.LZMAError)
_DATE = (2026, 1, 1, 0, 0, 0)  # of every member, so that the same files make the same archive


@dataclass(frozen=True)
class Kept:
    """Files of an experiment's trainings that are kept.

    folder  of the archives
    name    of a member: a path below the folder of run folders
    most    size of a member [bytes]
    last    endings of the files that make a training count as complete; they are written last
    """

    folder: Path
    name: re.Pattern[str]
    most: int
    last: tuple[str, ...]

    def write(self, runs: Path, folder: Path, files: Mapping[str, Sequence[Path]]) -> list[Path]:
        """Write archives, files by the name of each; return them, those without files left out.

        Raises ValueError where an archive holds files that `runs` lacks; then none is written.
        """
        written = {folder / f"{name}.zip": sorted(found) for name, found in files.items() if found}
        for archive, found in written.items():
            _check_kept(archive, {file.relative_to(runs).as_posix() for file in found})
        for archive, found in written.items():
            with replacing(archive) as part, ZipFile(part, "w") as zipped:
                for file in found:
                    member = ZipInfo(file.relative_to(runs).as_posix(), _DATE)
                    zipped.writestr(member, file.read_bytes(), ZIP_DEFLATED, compresslevel=9)
        return list(written)

    def unpack(self, archive: Path, runs: Path) -> int:
        """Write the archive's files where there are none; return the number of those written.

        Raises ValueError where it is damaged, or a member is no file of a training.
        """
        try:
            with ZipFile(archive) as zipped:
                content = {m.filename: self._read(zipped, m) for m in zipped.infolist()}
        except (*_DAMAGED, RuntimeError) as error:  # encrypted
            raise ValueError(f"{archive} is damaged: {error or type(error).__name__}") from error
        missing = [name for name in content if not (runs / name).exists()]
        for name in sorted(missing, key=lambda name: name.endswith(self.last)):
            with replacing(runs / name) as part:
                part.write_bytes(content[name])
        return len(missing)

    def _read(self, zipped: ZipFile, member: ZipInfo) -> bytes:
        """The content of a member; BadZipFile where it is no file of a training, or too large."""
        if not self.name.fullmatch(member.filename) or member.file_size > self.most:
            raise BadZipFile(f"{member.filename!r} is no file of a training")
        return zipped.read(member)

    def command(self, about: str, pack: Pack, **others: Callable[[Path], str]) -> int:
        """Pack, unpack, or do what another verb says to the run folders; return the exit code."""
        parser = argparse.ArgumentParser(description=about)
        parser.add_argument("what", choices=["pack", "unpack", *others])
        parser.add_argument("--runs", type=Path, required=True, help="folder of the run folders")
        parser.add_argument("--archives", type=Path, default=self.folder, help="of the archives")
        options = parser.parse_args()
        other = others.get(options.what)
        try:
            print(other(options.runs) if other else self._run(options, pack))
        except (OSError, ValueError, RuntimeError) as error:
            sys.exit(f"error: {error}")
        return 0

    def _run(self, options: argparse.Namespace, pack: Pack) -> str:
        if options.what == "pack":
            written = list(pack(options.runs, options.archives))
            if not written:
                raise ValueError(f"{options.runs} has no complete training or evaluation")
            return f"{len(written)} archives in {options.archives}"
        found = sorted(options.archives.glob("*.zip"))
        if not found:
            raise ValueError(f"{options.archives} has no archives")
        count = sum(self.unpack(each, options.runs) for each in found)
        return f"{count} files written into {options.runs}"


_RUN = ("config.json", "versions.json", "metrics.csv", "checkpoints/last.json")


def kept_levels(experiment: str) -> Kept:
    """What is kept of trainings with levels of pruning, in results/<experiment>/trainings."""
    name = re.compile(
        rf"{experiment}-[\w-]+/({'|'.join(map(re.escape, _RUN))}"
        rf"|checkpoints/{LEVEL}[\w+]+\.(json|safetensors))"
        r"|evaluations/([\w+=-][\w.+=-]*/)?[\w+=-][\w.+= -]*\.json"
    )
    # a training counts as complete by its counters, which must not come before the rest
    return Kept(RESULTS / experiment / "trainings", name, 16 << 20, ("last.json",))


def files_left(runs: Path, trainings: Iterable[TrainingJob]) -> dict[str, list[Path]]:
    """The evaluations, and of each training that ended what says how, and its levels' policies."""
    files = {"evaluations": [*(runs / "evaluations").rglob("*.json")]}
    for training in trainings:
        if training.is_trained:
            run = training.existing_run
            files[training.name] = [
                *(run / name for name in _RUN if (run / name).is_file()),
                *run.glob(f"checkpoints/{LEVEL}*"),
            ]
    return files


def _check_kept(archive: Path, names: set[str]) -> None:
    """Refuse to write an archive anew without what it holds: it was not trained again."""
    if not archive.is_file():
        return
    with ZipFile(archive) as zipped:
        lost = set(zipped.namelist()) - names
    if lost:
        raise ValueError(f"{archive} holds {min(lost)}, which --runs lacks: unpack it there first")
