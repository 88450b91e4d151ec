"""A fuzzing run: a process that tries files one after another, and the outcome of each."""

import json
import multiprocessing
import os
import resource
import shutil
import time
import traceback
from collections import Counter
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np

from benchmarks.fuzz_corpus import write_corpus
from benchmarks.fuzz_formats import FORMATS
from benchmarks.fuzz_mutations import mutate
from benchmarks.fuzz_trials import attempt
from spikedeploy.files import write_text

SECONDS = 20.0  # for a file, by the clock: other processes may be running
CPU_SECONDS = 5.0  # that a file may take
MEGABYTES = 500.0  # that it may take besides the libraries and its own size
NETWORKS = 0.6  # at least this part of the files, where all formats are drawn from
BYTES = 8 << 30  # of address space, for libraries, their threads and the file


@dataclass(frozen=True)
class Outcome:
    """The outcome of one file.

    read: whether it was; then a chip may still have refused it.
    refused: names of the SpikedeployErrors.
    violation: the error that is not ours, the limit that was passed, or how the process died;
        empty is none.
    seconds: of CPU.
    megabytes: highest resident memory while it was tried, besides what libraries took before.
    """

    number: int
    source: str
    damage: str
    read: bool
    refused: tuple[str, ...]
    violation: str
    seconds: float
    megabytes: float


def fuzz(
    numbers: range, seed: int, folder: Path, keep: Path | None = None, name: str = ""
) -> Iterator[Outcome]:
    """The outcome of each number, tried one after the other in a process of their own.

    keep: folder for the files that violate.
    name: of the format; all by default.
    """
    corpus = write_corpus(folder / "corpus")
    if name:
        corpus = [path for path in corpus if path.suffix == FORMATS[name].suffix]
    worker = Worker(corpus, seed, folder, name)
    for number in numbers:
        outcome = worker.outcome(number)
        if worker.died:
            worker = Worker(corpus, seed, folder, name)
        if outcome.violation and keep:
            _keep(folder, keep / f"{name}{number}")
        yield outcome
    worker.end()


def _keep(folder: Path, place: Path) -> None:
    """Copy the file of a violation."""
    place.mkdir(parents=True, exist_ok=True)
    for file in folder.glob("file.*"):
        copy = shutil.copytree if file.is_dir() else shutil.copyfile
        copy(file, place / file.name)


class Worker:
    """A process that tries files."""

    def __init__(self, corpus: list[Path], seed: int, folder: Path, name: str) -> None:
        self.died = False
        self._pipe, other = multiprocessing.Pipe()
        work = (other, corpus, seed, folder, name)
        self._process = multiprocessing.get_context("fork").Process(target=serve, args=work)
        self._process.start()
        other.close()

    def outcome(self, number: int) -> Outcome:
        """Of one file."""
        began = time.perf_counter()
        self._pipe.send(number)
        try:
            if self._pipe.poll(SECONDS):
                found: Outcome = self._pipe.recv()
                return found
            how = f"took more than {SECONDS:g} s"
        except (EOFError, ConnectionError):
            self._process.join(1)
            how = f"the process died, exit code {self._process.exitcode}"
        self.died = True
        self._process.kill()
        self._process.join()
        return Outcome(number, "", "", False, (), how, time.perf_counter() - began, 0.0)

    def end(self) -> None:
        """End the process's input."""
        self._pipe.send(None)
        self._process.join()


def serve(pipe: Connection, corpus: list[Path], seed: int, folder: Path, name: str) -> None:
    """Try the files whose numbers arrive, until the input ends."""
    resource.setrlimit(resource.RLIMIT_AS, (BYTES, BYTES))
    number = pipe.recv()
    for path in corpus:  # so that libraries are loaded
        _clear(folder)
        copy = folder / f"file{path.suffix}"
        shutil.copytree(path, copy) if path.is_dir() else shutil.copyfile(path, copy)
        attempt(copy, np.random.default_rng(0))
    libraries = resident("VmRSS")
    while number is not None:
        pipe.send(tried(number, corpus, seed, folder, name, libraries))
        number = pipe.recv()


def tried(
    number: int, corpus: list[Path], seed: int, folder: Path, name: str, libraries: float
) -> Outcome:
    """The outcome of one file."""
    rng = np.random.default_rng([seed, number])
    networks = [path for path in corpus if path.suffix == ".nir"]
    some = networks if networks and rng.random() < NETWORKS else corpus
    source = some[rng.integers(len(some))]
    _clear(folder)
    path = folder / f"file{source.suffix}"
    damage = mutate(source, path, rng, name)
    _forget_highest()
    began = _cpu()
    read, refused, violation = False, (), ""
    try:
        read, refused = attempt(path, rng)
    except BaseException as error:
        place = traceback.extract_tb(error.__traceback__)[-1]
        violation = f"{type(error).__name__} at {Path(place.filename).name}:{place.lineno}: {error}"
    seconds, megabytes = _cpu() - began, resident("VmHWM") - libraries
    # mutations several times over may write hundreds of megabytes
    size = path.stat().st_size / 1e6 if path.is_file() else 0.0
    if seconds > CPU_SECONDS or megabytes > MEGABYTES + size:
        violation = violation or f"{seconds:.1f} s, {megabytes:.0f} MB"
    return Outcome(number, source.name, damage, read, refused, violation, seconds, megabytes)


def _clear(folder: Path) -> None:
    """Remove the file that was tried, and what was made of it."""
    for old in folder.glob("file.*"):
        shutil.rmtree(old) if old.is_dir() else old.unlink()


def _cpu() -> float:
    """Seconds that this process and its children have computed."""
    return sum(os.times()[:4])


def _forget_highest() -> None:
    """Reset the peak of resident memory, where the system can."""
    clear = Path("/proc/self/clear_refs")
    if clear.exists():
        clear.write_text("5")


def resident(field: str) -> float:
    """Resident memory [MB] of this process: VmRSS now, VmHWM at most since the reset."""
    status = Path("/proc/self/status")
    if status.exists():
        return int(status.read_text().split(f"{field}:")[1].split()[0]) / 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def recorded(file: Path) -> list[Outcome]:
    """The outcomes in a record, one a line; a last one that was cut off is not among them."""
    lines = file.read_text(encoding="utf-8").split("\n")[:-1] if file.is_file() else []
    made = [json.loads(line) for line in lines]
    return [Outcome(**{**each, "refused": tuple(each["refused"])}) for each in made]


def resumed(file: Path, count: int, seed: int, keep: Path | None, name: str, folder: Path) -> None:
    """Try the files of a format up to number `count` that a record has not yet, and add them."""
    done = recorded(file)
    write_text(file, "".join(_line(outcome) for outcome in done))
    with file.open("a", encoding="utf-8") as record:
        for outcome in fuzz(range(len(done), count), seed, folder, keep, name):
            record.write(_line(outcome))
            record.flush()


def _line(outcome: Outcome) -> str:
    return json.dumps(asdict(outcome)) + "\n"


def table(outcomes: dict[str, list[Outcome]]) -> str:
    """A line for each format, and one for each violation."""
    lines = ["format        files   read   refused  s in all  slowest  most MB  violations"]
    for name, found in outcomes.items():
        read, wrong = sum(o.read for o in found), sum(bool(o.violation) for o in found)
        seconds = [o.seconds for o in found]
        lines.append(
            f"{name:<11} {len(found):>7} {read:>6} {len(found) - read - wrong:>9} "
            f"{sum(seconds):>9.0f} {max(seconds, default=0):>8.2f} "
            f"{max((o.megabytes for o in found), default=0):>8.0f} {wrong:>11}"
        )
    wrong_ones = [(name, o) for name, found in outcomes.items() for o in found if o.violation]
    return "\n".join([*lines, *(f"  {name} {describe(o)}" for name, o in wrong_ones)])


def summary(outcomes: list[Outcome]) -> str:
    """The table, and a line for each violation."""
    read, whole = sum(o.read for o in outcomes), sum(o.read and not o.refused for o in outcomes)
    reasons = Counter(name for o in outcomes for name in set(o.refused))
    slowest = max(outcomes, key=lambda o: o.seconds)
    fattest = max(outcomes, key=lambda o: o.megabytes)
    wrong = [o for o in outcomes if o.violation]
    lines = [
        f"files       {len(outcomes)}",
        f"read        {read}, and {whole} of them refused by nothing afterwards",
        "refused by",
        *(f"  {name:<20} {count}" for name, count in reasons.most_common()),
        f"seconds     {sum(o.seconds for o in outcomes):.1f}, slowest {slowest.seconds:.2f} "
        f"({_where(slowest)})",
        f"megabytes   {fattest.megabytes:.0f} at most ({_where(fattest)})",
        f"violations  {len(wrong)}",
        *(f"  {describe(o)}" for o in wrong),
    ]
    return "\n".join(lines)


def describe(outcome: Outcome) -> str:
    """The violation, and of which file."""
    return f"{_where(outcome)}: {outcome.violation[:300]}"


def _where(outcome: Outcome) -> str:
    return f"{outcome.number}: {outcome.source} {outcome.damage}"
