"""Kill trainings at random moments, resume them, and compare every file with an unbroken run's.

    python -m tests.trainers.kills [--kills 20] [--seed 0] [--only sac] [--keep FOLDER]

Small trainings of every algorithm are started, killed (SIGKILL), resumed and killed again: one
half of the kills at a random time, the other at a random one of the file operations, which are
short and would hardly be met otherwise. One interruption in five is a stop (SIGTERM), which leaves
a checkpoint where the unbroken run has none. Each chain of interruptions ends with a training that
may finish. Its run folder must then hold the same files as that of the run that nothing stopped,
with the same bytes (`differences`). Exits with 1 where it does not.
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
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from spikedeploy.trainers import ALGORITHMS
from spikedeploy.trainers.progress import Interrupt
from spikedeploy.trainers.train import train

FINISHED, FAILED, STOPPED = 0, 1, 3  # exit codes of a training
_MODULES = ("mujoco", "pymunk", "onnxruntime", "matplotlib.figure", "torch._dynamo")
_FILE_EVENTS = ("open", "os.rename", "os.remove", "os.mkdir", "os.truncate")
_LONGEST = 4  # interruptions of a chain
_STOPS, _WRITES = 0.2, 0.5  # parts of the interruptions, and of the kills
_TITLED = ("curve.png", "report.html")  # with the folder's name


class Case(NamedTuple):
    """A training of seconds; `start` names the case whose finished run it goes on from."""

    recipe: str
    settings: tuple[str, ...]
    start: str = ""


CASES = {
    # the ring of the replay is overwritten twice, and the temperature is learned
    "sac": Case("smoke", (
        "steps=300", "checkpoint_every=50", "buffer=110", "learn_temperature=true",
        "normaliser.finish=200", "log_every=30", "validation.every=60")),
    "ppo": Case("smoke-kart", ("steps=768", "checkpoint_every=128", "env.count=3")),
    "ppo-mlp": Case("ppo-mlp", (
        "env.name=CartPole-v1", "steps=600", "horizon=20", "checkpoint_every=120",
        "validation.every=120", "validation.episodes=2", "env.count=2")),
    "distill": Case("smoke-distill", ("teacher=hexapod/sac", "iterations=3", "checkpoint_every=7")),
    "distill-snn": Case("distill-snn", (
        "env.name=CartPole-v1", "teacher=tests.trainers.kills:lean", "updates=60",
        "iterations=3", "checkpoint_every=7", "validation.every=20", "log_every=5",
        "policy.coding=bernoulli", "validation.episodes=2", "states=200")),
    "sparse": Case("smoke-sparse", ("checkpoint_every=7",)),
    "sparse-ppo": Case("smoke-sparse-tuned", ("iterations=4",), start="sparse"),
}  # fmt: skip


def lean(observation: np.ndarray) -> int:
    """Push CartPole's cart to where the pole falls: a teacher."""
    return int(observation[2] + observation[3] > 0)


class Moment(NamedTuple):
    """When a training is interrupted: after seconds, or before one of its file operations."""

    seconds: float = 0.0
    write: int = 0
    stop: bool = False


class End(NamedTuple):
    """How a training ended: its run folder, exit code, seconds, and file operations there."""

    run: Path | None
    status: int
    seconds: float
    writes: int


def main() -> None:
    """Run the chains and print what came of them as JSON."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--kills", type=int, default=20, help="of each training")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", nargs="*", choices=CASES, default=list(CASES))
    parser.add_argument("--keep", type=Path, help="folder in which the run folders stay")
    options = parser.parse_args()
    for name in (*_MODULES, *(target.split(":")[0] for target in ALGORITHMS.values())):
        import_module(name)  # so that every fork has it
    with tempfile.TemporaryDirectory() as temporary:
        folder = options.keep or Path(temporary)
        rows = [try_case(name, folder, options.kills, options.seed) for name in options.only]
    print(json.dumps(rows))
    wrong = [each for row in rows for each in row["differences"]]
    sys.exit("\n".join(wrong) if wrong else 0)


def try_case(name: str, folder: Path, kills: int, seed: int) -> dict[str, Any]:
    """Return what came of a case after so many kills; `differences` of its chains, in words."""
    whole, rng = unbroken(name, folder), np.random.default_rng([seed, len(name), kills])
    met: list[Moment] = []
    wrong: list[str] = []
    chains = 0

    def killed() -> int:
        return sum(not moment.stop for moment in met)

    while killed() < kills:
        runs, length = folder / name / f"chain-{chains}", int(rng.integers(1, _LONGEST + 1))
        for moment in [_moment(rng, whole) for _ in range(length)]:
            end = _trained(name, folder, runs, moment)
            if end.status == FINISHED:
                break
            if end.status != -signal.SIGTERM:  # which came before the training listened
                met.append(moment)
            if killed() == kills:
                break
        end = _trained(name, folder, runs, Moment())
        wrong += [f"{name} chain {chains}: {each}" for each in differences(whole.run, end.run)]
        chains += 1
    return {
        "training": name,
        "recipe": CASES[name].recipe,
        "kills": killed(),
        "at a write": sum(moment.write > 0 for moment in met),
        "stops": sum(moment.stop for moment in met),
        "chains": chains,
        "differences": wrong,
    }


@cache
def unbroken(name: str, folder: Path) -> End:
    """Return how a training ended that nothing stopped."""
    return _trained(name, folder, folder / name / "whole", Moment())


def _trained(name: str, folder: Path, runs: Path, moment: Moment) -> End:
    case = CASES[name]
    settings = case.settings
    if case.start:
        settings = (*settings, f"start={unbroken(case.start, folder).run}")
    return run_once(case.recipe, settings, runs, moment)


def _moment(rng: np.random.Generator, whole: End) -> Moment:
    """Return a random moment of a training that takes as long as the unbroken one."""
    after = float(rng.uniform(0, whole.seconds))
    if rng.random() < _STOPS:
        return Moment(seconds=after, stop=True)
    if rng.random() < _WRITES:
        return Moment(write=int(rng.integers(1, whole.writes + 1)))
    return Moment(seconds=after)


def run_once(recipe: str, settings: tuple[str, ...], runs: Path, moment: Moment) -> End:
    """Train in a process of its own, or resume what is in the folder; return how it ended."""
    began, log, count = time.perf_counter(), runs.parent / "log", runs.parent / "writes"
    resume = _run_in(runs)
    if resume is None:
        shutil.rmtree(runs, ignore_errors=True)  # it died before it had a configuration
        runs.mkdir(parents=True)
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
    if status == FAILED or (status != FINISHED and moment == Moment()):
        raise RuntimeError(f"{recipe} failed: {log.read_text()}")
    writes = int(count.read_text()) if status == FINISHED else 0
    return End(_run_in(runs), status, time.perf_counter() - began, writes)


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


def _run_in(runs: Path) -> Path | None:
    """Return the run folder in a folder, if there is one."""
    return next((file.parent for file in sorted(runs.glob("*/config.json"))), None)


def differences(whole: Path, other: Path | None) -> list[str]:
    """Return what differs between the folder of an unbroken run and another, in words.

    Left out are columns of metrics.csv that are times, the bytes of what has the folder's name in
    it, and TensorBoard's files.
    """
    if other is None:
        return ["there is no run folder"]
    ours, theirs = _contents(whole), _contents(other)
    found = [f"{name} is missing" for name in sorted(ours.keys() - theirs)]
    found += [f"{name} is left over" for name in sorted(theirs.keys() - ours)]
    both = sorted(ours.keys() & theirs)
    return found + [f"{name} differs" for name in both if ours[name] != theirs[name]]


def _contents(run: Path) -> dict[str, object]:
    """Return what must be equal of each file of a run."""
    found: dict[str, object] = {}
    for path in (each for each in run.rglob("*") if each.is_file()):
        name = str(path.relative_to(run))
        if path.name == "metrics.csv":
            with path.open(newline="") as file:
                rows = list(csv.DictReader(file))
            found[name] = [{k: v for k, v in r.items() if not k.endswith("_per_s")} for r in rows]
        elif not name.startswith("events.out."):
            found[name] = None if path.name in _TITLED else path.read_bytes()
    return found


if __name__ == "__main__":
    main()
