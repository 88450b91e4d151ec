"""Kill trainings at random moments, resume them, and compare every file with an unbroken run's.

    python -m lab kill [--kills 20] [--seed 0] [--only sac] [--keep FOLDER]

Small trainings of every algorithm are started, killed (SIGKILL), resumed and killed again: one
half of the kills at a random time, the other at a random one of the file operations, which are
short and would hardly be met otherwise. Among the kills some are stopped (SIGTERM), which leaves a
checkpoint where the unbroken run has none. Each chain of them ends with a training that may finish.
Its run folder must then hold the same files as that of the run that nothing stopped, with the
same bytes; left out are the columns of metrics.csv that are times, what has the folder's name in
it (curves, card and page) and TensorBoard's files. Exits with 1 on a difference.
"""

import argparse
import csv
import json
import os
import shutil
import signal
import sys
import tempfile
import threading
import time
import traceback
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from spikedeploy.reports.table import markdown_text
from spikedeploy.trainers import ALGORITHMS
from spikedeploy.trainers.progress import Interrupt
from spikedeploy.trainers.train import train

FINISHED, FAILED, STOPPED = 0, 1, 3
KILLED, UNHEARD = -signal.SIGKILL, -signal.SIGTERM
# torch imports the last one for its first optimiser, which takes longer than these trainings
_MODULES = ("mujoco", "pymunk", "onnxruntime", "matplotlib.figure", "torch._dynamo")
_FILE_EVENTS = ("open", "os.rename", "os.remove", "os.mkdir", "os.truncate")
_MOST = 4  # interruptions of a chain
_STOPS = 0.2  # part of them that are stops
_WRITES = 0.5  # part of the kills that are at file operations
# with the folder's name
_TITLED = ("curve.png", "curve.svg", "card.md", "report.html")


def main() -> None:
    """Run the chains and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--kills", type=int, default=20, help="of each training")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", nargs="*", choices=CASES, default=list(CASES))
    parser.add_argument("--keep", type=Path, help="folder in which the run folders stay")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        killer = Killer(options.keep or Path(temporary), options.seed)
        rows = []
        for name in options.only:
            rows.append(killer.try_case(CASES[name], options.kills))
            print(table(rows[-1:]), file=sys.stderr, flush=True)
    print(json.dumps(rows) if options.json else table(rows))
    sys.exit(any(row["differences"] for row in rows))


class Moment(NamedTuple):
    """When a training is interrupted; never, by default.

    seconds: after its start
    write: before this of its file operations, counted from 1
    stop: whether it is asked to stop by SIGTERM, and not killed
    """

    seconds: float = 0.0
    write: int = 0
    stop: bool = False


class End(NamedTuple):
    """How a training ended.

    status: FINISHED, FAILED, STOPPED, KILLED, or UNHEARD for a stop before it listened
    writes: file operations in the run folder
    log: what it said
    """

    run: Path
    status: int
    seconds: float
    writes: int
    log: str


def run_once(recipe: str, settings: tuple[str, ...], runs: Path, moment: Moment) -> End:
    """Train in a process of its own, or resume what is in the folder; return how it ended."""
    began, log, count = time.perf_counter(), runs.parent / "log", runs.parent / "writes"
    resume = _only(runs)
    if resume is None:
        shutil.rmtree(runs, ignore_errors=True)  # it died before it had a configuration
        runs.mkdir(parents=True)
    sys.stdout.flush()
    process = os.fork()
    if process == 0:  # which leaves without any of its parent's clean-up
        status = FAILED
        try:
            output = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
            os.dup2(output, 1)
            os.dup2(output, 2)
            seen = _watch_files(runs, moment.write)
            if moment.seconds:
                number = signal.SIGTERM if moment.stop else signal.SIGKILL
                timer = threading.Timer(moment.seconds, os.kill, (os.getpid(), number))
                timer.daemon = True
                timer.start()
            stopped, more = Interrupt(), () if resume else settings
            train(recipe, overrides=more, resume=resume, runs=runs, quiet=True, interrupt=stopped)
            status = STOPPED if stopped.share is not None else FINISHED
            count.write_text(str(len(seen)))
        except BaseException:
            traceback.print_exc()
        finally:
            sys.stderr.flush()
            os._exit(status)
    status = os.waitstatus_to_exitcode(os.waitpid(process, 0)[1])
    writes = int(count.read_text()) if status == FINISHED else 0
    taken = time.perf_counter() - began
    return End(_only(runs) or runs, status, taken, writes, log.read_text())


def _watch_files(runs: Path, last: int) -> list[str]:
    """Count file operations under a folder, and kill the process before the last one."""
    seen: list[str] = []

    def hook(event: str, arguments: tuple[Any, ...]) -> None:
        if event in _FILE_EVENTS and str(arguments[0]).startswith(str(runs)):
            seen.append(event)
            if len(seen) == last:
                os.kill(os.getpid(), signal.SIGKILL)

    sys.addaudithook(hook)
    return seen


def _only(runs: Path) -> Path | None:
    """Return the run folder in a folder, if there is one."""
    return next((file.parent for file in sorted(runs.glob("*/config.json"))), None)


def differences(whole: Path, other: Path | None) -> list[str]:
    """Return what differs between the folder of an unbroken run and another, in words."""
    if other is None:
        return ["there is no run folder"]
    ours, theirs = _contents(whole), _contents(other)
    found = [f"{name} is missing" for name in sorted(ours.keys() - theirs)]
    found += [f"{name} is left over" for name in sorted(theirs.keys() - ours)]
    both = sorted(ours.keys() & theirs)
    return found + [f"{name} differs" for name in both if ours[name] != theirs[name]]


def _contents(run: Path) -> dict[str, object]:
    """Return what must be equal of each file of a run but TensorBoard's."""
    found: dict[str, object] = {}
    for path in run.rglob("*"):
        name = str(path.relative_to(run))
        if not path.is_file() or name.startswith("events.out."):
            continue
        if path.name == "metrics.csv":
            with path.open(newline="") as file:
                rows = list(csv.DictReader(file))
            found[name] = [
                {k: v for k, v in row.items() if not k.endswith("_per_s")} for row in rows
            ]
        else:
            found[name] = None if path.name in _TITLED else path.read_bytes()
    return found


@dataclass(frozen=True)
class Case:
    """A training of seconds.

    start: name of the case whose finished run it goes on from
    """

    name: str
    recipe: str
    settings: tuple[str, ...]
    start: str = ""


CASES = {
    case.name: case
    for case in (
        # the ring of the replay is overwritten twice, and the temperature is learned
        Case("sac", "smoke", (
            "steps=300", "checkpoint_every=50", "buffer=110", "learn_temperature=true",
            "normaliser.finish=200", "log_every=30", "validation.every=60")),
        Case("ppo", "smoke-kart", ("steps=768", "checkpoint_every=128", "env.count=3")),
        Case("ppo-mlp", "ppo-mlp", (
            "env.name=CartPole-v1", "steps=1500", "horizon=50", "checkpoint_every=300",
            "validation.every=300", "validation.episodes=2", "env.count=2")),
        Case("distill", "smoke-distill", (
            "teacher=hexapod/sac", "iterations=3", "checkpoint_every=7")),
        Case("distill-snn", "distill-snn", (
            "env.name=CartPole-v1", "teacher=lab.kill:lean", "updates=60",
            "iterations=3", "checkpoint_every=7", "validation.every=20", "log_every=5",
            "policy.coding=bernoulli", "validation.episodes=2", "states=200")),
        Case("sparse", "smoke-sparse", ("checkpoint_every=7",)),
        Case("sparse-ppo", "smoke-sparse-tuned", ("iterations=4",), start="sparse"),
    )
}  # fmt: skip


def lean(observation: np.ndarray) -> int:
    """A teacher of CartPole: push to where the pole falls."""
    return int(observation[2] + observation[3] > 0)


class Killer:
    """Runs cases in a folder."""

    def __init__(self, folder: Path, seed: int) -> None:
        self._folder, self._seed = folder, seed
        for name in (*_MODULES, *(target.split(":")[0] for target in ALGORITHMS.values())):
            import_module(name)  # so that every fork has it
        self._whole: dict[str, End] = {}

    def try_case(self, case: Case, kills: int) -> dict[str, Any]:
        """Return what came of a case after so many kills.

        kills, writes: SIGKILLs that met a training, and those of them at a file operation
        stops: SIGTERMs that met one
        differences: of each chain that did not end as the unbroken run, in words
        """
        began, rng = time.perf_counter(), np.random.default_rng([self._seed, len(case.name), kills])
        whole = self.unbroken(case)
        met: list[Moment] = []
        wrong: list[str] = []
        chains = 0
        while (done := sum(not moment.stop for moment in met)) < kills:
            runs = self._folder / case.name / f"chain-{chains}"
            met += (interruptions := self._chain(case, runs, whole, rng, kills - done))
            if found := differences(whole.run, _only(runs)):
                wrong.append(f"{case.name} chain {chains} ({interruptions}): {'; '.join(found)}")
            chains += 1
        return {
            "name": case.name,
            "recipe": case.recipe,
            "kills": done,
            "writes": sum(moment.write > 0 for moment in met),
            "stops": len(met) - done,
            "chains": chains,
            "files": sum(path.is_file() for path in whole.run.rglob("*")),
            "seconds": time.perf_counter() - began,
            "differences": wrong,
        }

    def unbroken(self, case: Case) -> End:
        """Return how a training ended that nothing stopped."""
        if case.name not in self._whole:
            runs = self._folder / case.name / "whole"
            self._whole[case.name] = self._finished(case, runs, [])
        return self._whole[case.name]

    def _chain(
        self, case: Case, runs: Path, whole: End, rng: np.random.Generator, kills: int
    ) -> list[Moment]:
        """Interrupt a training a few times and let it finish; return what met it."""
        met: list[Moment] = []
        for _ in range(int(rng.integers(1, _MOST + 1))):
            moment = _moment(rng, whole)
            end = self._train(case, runs, moment)
            if end.status == FINISHED:
                return met
            if end.status not in (KILLED, STOPPED, UNHEARD):
                raise RuntimeError(f"{case.name} failed after {met}: {end.log}")
            if end.status != UNHEARD:  # else it did not listen yet
                met.append(moment)
            if sum(not moment.stop for moment in met) == kills:
                break
        self._finished(case, runs, met)
        return met

    def _finished(self, case: Case, runs: Path, met: list[Moment]) -> End:
        end = self._train(case, runs, Moment())
        if end.status != FINISHED:
            raise RuntimeError(f"{case.name} did not finish after {met}: {end.log}")
        return end

    def _train(self, case: Case, runs: Path, moment: Moment) -> End:
        settings = case.settings
        if case.start:
            settings = (*settings, f"start={self.unbroken(CASES[case.start]).run}")
        return run_once(case.recipe, settings, runs, moment)


def _moment(rng: np.random.Generator, whole: End) -> Moment:
    """Return a random moment of a training that takes as long as the unbroken one."""
    after = float(rng.uniform(0, whole.seconds))
    if rng.random() < _STOPS:
        return Moment(seconds=after, stop=True)
    if rng.random() < _WRITES:
        return Moment(write=int(rng.integers(1, whole.writes + 1)))
    return Moment(seconds=after)


def table(rows: list[dict[str, Any]]) -> str:
    """Return the rows as a table, and a line for each difference."""
    head = ["training", "recipe", "kills", "at a write", "stops", "chains", "equal", "files", "s"]
    cells = [
        [
            *(str(r[name]) for name in ("name", "recipe", "kills", "writes", "stops", "chains")),
            *map(str, (r["chains"] - len(r["differences"]), r["files"], round(r["seconds"]))),
        ]
        for r in rows
    ]
    wrong = (difference for row in rows for difference in row["differences"])
    return "\n".join([markdown_text([head, *cells]), *wrong])
