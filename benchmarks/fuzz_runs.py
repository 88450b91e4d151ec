"""A fuzzing run: a process that tries files one after another, and the outcome of each."""

import multiprocessing
import resource
import shutil
import time
import traceback
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np

from benchmarks.fuzz_corpus import write_corpus
from benchmarks.fuzz_mutations import mutate
from benchmarks.fuzz_trials import attempt

SECONDS = 10.0  # for a file
NETWORKS = 0.6  # at least this part of the files
BYTES = 6 << 30  # of address space, for numpy, its threads and the file


@dataclass(frozen=True)
class Outcome:
    """The outcome of one file.

    read: whether it was; then a chip may still have refused it.
    refused: names of the SpikedeployErrors.
    violation: the error that is not ours, or how the process died; empty is none.
    megabytes: highest resident memory while it was tried.
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
    numbers: range, seed: int, folder: Path, keep: Path | None = None, only: str = ""
) -> Iterator[Outcome]:
    """The outcome of each number, tried one after the other in a process of their own.

    keep: folder for the files that violate.
    only: a format, such as ".onnx"; all by default.
    """
    corpus = [path for path in write_corpus(folder / "corpus") if path.suffix.endswith(only)]
    worker = Worker(corpus, seed, folder)
    for number in numbers:
        outcome = worker.outcome(number)
        if worker.died:
            worker = Worker(corpus, seed, folder)
        if outcome.violation and keep:
            keep.mkdir(parents=True, exist_ok=True)
            for file in filter(Path.is_file, folder.glob("file.*")):
                shutil.copy(file, keep / f"{number}-{file.name}")
        yield outcome
    worker.end()


class Worker:
    """A process that tries files."""

    def __init__(self, corpus: list[Path], seed: int, folder: Path) -> None:
        self.died = False
        self._pipe, other = multiprocessing.Pipe()
        work = (other, corpus, seed, folder)
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


def serve(pipe: Connection, corpus: list[Path], seed: int, folder: Path) -> None:
    """Try the files whose numbers arrive, until the input ends."""
    resource.setrlimit(resource.RLIMIT_AS, (BYTES, BYTES))
    while (number := pipe.recv()) is not None:
        pipe.send(tried(number, corpus, seed, folder))


def tried(number: int, corpus: list[Path], seed: int, folder: Path) -> Outcome:
    """The outcome of one file."""
    rng = np.random.default_rng([seed, number])
    networks = [path for path in corpus if path.suffix == ".nir"]
    some = networks if networks and rng.random() < NETWORKS else corpus
    source = some[rng.integers(len(some))]
    for old in folder.glob("file.*"):
        shutil.rmtree(old) if old.is_dir() else old.unlink()
    path = folder / f"file{source.suffix}"
    damage = mutate(source, path, rng)
    _forget_highest()
    began = time.perf_counter()
    read, refused, violation = False, (), ""
    try:
        read, refused = attempt(path, rng)
    except BaseException as error:
        place = traceback.extract_tb(error.__traceback__)[-1]
        violation = f"{type(error).__name__} at {Path(place.filename).name}:{place.lineno}: {error}"
    seconds = time.perf_counter() - began
    return Outcome(number, source.name, damage, read, refused, violation, seconds, _highest())


def _forget_highest() -> None:
    """Reset the peak of resident memory, where the system can."""
    clear = Path("/proc/self/clear_refs")
    if clear.exists():
        clear.write_text("5")


def _highest() -> float:
    """Peak resident memory [MB] since the reset, or since the process began."""
    status = Path("/proc/self/status")
    if status.exists():
        return int(status.read_text().split("VmHWM:")[1].split()[0]) / 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


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
