"""A training in a forked process, which kills itself at a moment that is asked for."""

import os
import signal
import sys
import threading
import time
import traceback
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

from spikedeploy.trainers import ALGORITHMS
from spikedeploy.trainers.interrupt import Interrupt
from spikedeploy.trainers.train import train

FINISHED, FAILED, STOPPED = 0, 1, 3
KILLED, UNHEARD = -signal.SIGKILL, -signal.SIGTERM
# torch imports the last one for its first optimiser, which takes longer than these trainings
_MODULES = ("mujoco", "pymunk", "onnxruntime", "matplotlib.figure", "torch._dynamo")
_FILE_EVENTS = ("open", "os.rename", "os.remove", "os.mkdir", "os.truncate")


@dataclass(frozen=True)
class Moment:
    """When a training is interrupted; never, by default.

    seconds: after its start
    write: before this of its file operations, counted from 1
    stop: whether it is asked to stop by SIGTERM, and not killed
    """

    seconds: float = 0.0
    write: int = 0
    stop: bool = False

    @property
    def kills(self) -> bool:
        """Whether it is a kill."""
        return not self.stop


@dataclass(frozen=True)
class End:
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


def load() -> None:
    """Import what trainings import, so that every fork has it."""
    for name in (*_MODULES, *(target.split(":")[0] for target in ALGORITHMS.values())):
        import_module(name)


def ended(
    recipe: str, settings: Sequence[str], runs: Path, resume: Path | None, moment: Moment
) -> End:
    """Train in a process of its own, and return how it ended."""
    began, log, count = time.perf_counter(), runs.parent / "log", runs.parent / "writes"
    sys.stdout.flush()
    process = os.fork()
    if process == 0:
        _child(recipe, settings, runs, resume, moment, log, count)
    status = os.waitstatus_to_exitcode(os.waitpid(process, 0)[1])
    run = next((file.parent for file in runs.glob("*/config.json")), runs)
    writes = int(count.read_text()) if status == FINISHED else 0
    return End(run, status, time.perf_counter() - began, writes, log.read_text())


def _child(
    recipe: str, settings: Sequence[str], runs: Path, resume: Path | None, moment: Moment,
    log: Path, count: Path,
) -> None:  # fmt: skip
    """Train, and leave the process without any of its parent's clean-up."""
    status = FAILED
    try:
        output = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        os.dup2(output, 1)
        os.dup2(output, 2)
        seen = _watch_files(runs, moment.write)
        if moment.seconds:
            number = signal.SIGTERM if moment.stop else signal.SIGKILL
            threading.Thread(target=_signal, args=(moment.seconds, number), daemon=True).start()
        interrupt = Interrupt()
        changes = () if resume else settings
        train(recipe, overrides=changes, resume=resume, runs=runs, quiet=True, interrupt=interrupt)
        status = STOPPED if interrupt.share is not None else FINISHED
        count.write_text(str(len(seen)))
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stderr.flush()
        os._exit(status)


def _signal(seconds: float, number: int) -> None:
    time.sleep(seconds)
    os.kill(os.getpid(), number)


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
