"""Journal of a run: rows of metrics, to CSV file, TensorBoard and progress bar."""

import signal
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from datetime import timedelta
from importlib.util import find_spec
from pathlib import Path
from types import FrameType
from typing import Any

from rich.console import Console, RenderableType
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
from rich.text import Text

from spikedeploy.trainers.metrics import Metrics, spike_rate
from spikedeploy.trainers.run_folder import RunFolder

# -- Progress of a training, for people: a bar on a terminal, lines elsewhere.

# metrics below the bar, and their formats, the most wanted first
_SHOWN = {
    "episode_return": "return {:,.0f}",
    "eval_return": "validation {:,.0f}",
    "best": "best {:,.0f}",
    "eval_success": "success {:.0%}",
    "spike_rate": "spikes {:.1%}",
    "steps_per_s": "{:,.0f} steps/s",
    "updates_per_s": "{:,.0f} updates/s",
    "phase": "phase {:.0f}",
    "walks": "{:,.0f} walks",
    "operations": "{:,.0f} operations",
}
PAUSE = 10.0  # seconds between two lines where there is no terminal
_WIDTH = 80  # of a pipe


class _Bar(Progress):
    """A bar as wide as the terminal, and one line of numbers below it."""

    note = ""

    def get_renderables(self) -> Iterable[RenderableType]:
        """The bar, then the numbers, cut where the terminal ends."""
        yield self.make_tasks_table(self.tasks)
        yield Text(self.note, no_wrap=True, overflow="ellipsis")


class ProgressBar:
    """Step, share, time left, latest returns and speed of a run, on stderr; nothing if quiet."""

    def __init__(self, title: str, quiet: bool = False, console: Console | None = None) -> None:
        self._title, self._quiet = title, quiet
        self._screen = console or Console(stderr=True, highlight=False)
        self._latest: dict[str, float] = {}
        self._step, self._total, self._said = 0, 0, time.monotonic()
        self._bar = _Bar(
            TextColumn("{task.fields[count]}", markup=False),
            TextColumn("{task.percentage:>3.0f} %"),
            BarColumn(bar_width=None),
            TimeRemainingColumn(),
            console=self._screen,
            expand=True,
            disable=quiet or not self._screen.is_terminal,
        )
        self._task = self._bar.add_task("", total=None, count="")

    def __enter__(self) -> "ProgressBar":
        if not self._quiet:
            self.say(self._title)
        self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        with suppress(OSError):  # a terminal that was closed takes nothing, and training goes on
            self._bar.stop()

    def say(self, line: str) -> None:
        """Write a line above the bar."""
        self._screen.print(line, markup=False, soft_wrap=True)

    def at(self, step: int, total: int) -> None:
        """Set the bar to a step."""
        self._step, self._total = step, total
        count = f"{step:,} / {total:,}"
        with suppress(OSError):
            self._bar.update(self._task, completed=step, total=total, count=count)
            self._bar.note = self._note()
            if not self._quiet and not self._screen.is_terminal:
                self._log()

    def show(self, row: Mapping[str, float]) -> None:
        """Show the returns and speed of a row of metrics."""
        self._latest.update({key: row[key] for key in _SHOWN if key in row})

    def _note(self) -> str:
        latest = {**self._latest, **self._speed()}
        return "  ".join(_SHOWN[key].format(latest[key]) for key in _SHOWN if key in latest)

    def _speed(self) -> dict[str, float]:
        """The speed of the last half minute; a row's is of the steps before that row."""
        speed = self._bar.tasks[self._task].speed
        names = [name for name in self._latest if name.endswith("_per_s")]
        return {} if speed is None else dict.fromkeys(names, speed)

    def _left(self) -> str:
        """The time left, at the speed of the last half minute; empty where that is not known."""
        left = self._bar.tasks[self._task].time_remaining
        return "" if left is None else f"{timedelta(seconds=round(left))} left"

    def _log(self) -> None:
        """A line, unless the last one was just written."""
        if time.monotonic() - self._said < PAUSE:
            return
        self._said = time.monotonic()
        share = 100 * self._step / self._total
        parts = f"{self._step:,} / {self._total:,}", f"{share:.0f} %", self._left(), self._note()
        line = "  ".join(filter(None, parts))
        print(line, file=sys.stderr, flush=True)


# -- Signals that ask a training to stop: at a checkpoint, so that it can be resumed.

# SIGTERM is what schedulers and `kill` send, SIGHUP a terminal that is closed; Windows lacks both
_NAMES = ("SIGINT", "SIGTERM", "SIGHUP")


class Interrupt:
    """While entered, Ctrl-C (SIGINT), SIGTERM and SIGHUP request a stop; a second one ends at once.

    requested: number of the signal that came, 0 for none
    share: part of the training that is done, where it stopped before its end
    """

    def __init__(self) -> None:
        self.requested = 0
        self.share: float | None = None
        self._before: dict[int, Any] = {}
        self._say: Callable[[str], None] | None = None

    def __call__(self) -> bool:
        """Return whether a stop was requested."""
        return bool(self.requested)

    @property
    def exit_code(self) -> int:
        """What shells return for the signal: 130, 143 or 129."""
        return 128 + (self.requested or signal.SIGINT)

    @contextmanager
    def acknowledged(self, bar: ProgressBar, quiet: bool) -> Iterator[None]:
        """Say beside the bar that it was pressed, at once."""
        self._say = None if quiet else bar.say
        with self:
            yield
        self._say = None

    def __enter__(self) -> "Interrupt":
        if threading.current_thread() is threading.main_thread():  # elsewhere Python forbids it
            for number in _heard():
                self._before[number] = signal.signal(number, self._request)
        return self

    def __exit__(self, *_: object) -> None:
        for number, before in self._before.items():
            signal.signal(number, before)
        self._before = {}

    def _request(self, number: int, frame: FrameType | None) -> None:
        if self.requested:
            raise KeyboardInterrupt
        self.requested = number
        if self._say is not None:
            with suppress(OSError):  # of a terminal that was closed
                self._say("stopping after this step … (Ctrl-C again stops at once)")


def _heard() -> list[int]:
    """The signals to listen to; SIGHUP is not one where nohup has it ignored."""
    found = [getattr(signal, name) for name in _NAMES if hasattr(signal, name)]
    ignored = signal.Handlers.SIG_IGN
    return [
        number
        for number in found
        if signal.getsignal(number) is not None
        and (number == signal.SIGINT or signal.getsignal(number) != ignored)
    ]


# -- Journal of a run: rows of metrics, to CSV file, TensorBoard and progress bar.


class Journal:
    """What an algorithm reports to while it learns."""

    def __init__(
        self,
        run: RunFolder,
        columns: tuple[str, ...],
        bar: "ProgressBar",
        watch: Callable[[Path], None] | None = None,
        film: Callable[[Path, int, int], None] | None = None,
    ) -> None:
        """watch: is called with the run folder after each row.

        film: likewise, with the step and the steps of the whole training too
        """
        self._path, self._watch, self._film = run.path, watch, film
        self._progress = 0, 1
        self.metrics = Metrics(run.metrics, columns)
        self.board = _TensorBoardLog(run.path)
        self.bar = bar

    def at(self, step: int, total: int) -> None:
        """Report progress."""
        self._progress = step, total
        self.bar.at(step, total)

    def add(self, row: Mapping[str, float]) -> None:
        """Report one row of metrics; values without a column are dropped."""
        known = {name: row[name] for name in self.metrics.columns if name in row}
        self.metrics.add(known)
        seen = _seen(row)
        self.board.add(int(row[self.metrics.columns[0]]), {**known, **seen})
        self.bar.show({**row, **seen})
        if self._watch is not None:
            self._watch(self._path)
        if self._film is not None:
            self._film(self._path, *self._progress)

    def rewind(self, step: int) -> None:
        """Drop the rows after a step, on resuming from it."""
        self.metrics.rewind(step)
        self.board.rewind(step)

    def close(self) -> None:
        """Close the files."""
        self.board.close()


def _seen(row: Mapping[str, float]) -> dict[str, float]:
    """Success and spike rate of a validation, for TensorBoard and people; the CSV has neither."""
    seen = {}
    if success := [row[name] for name in ("eval_success", "eval_finish") if name in row]:
        seen["eval_success"] = success[0]
    if (rate := spike_rate(row)) is not None:
        seen["spike_rate"] = rate
    return seen


class _TensorBoardLog:
    """TensorBoard event file in the run folder; does nothing if TensorBoard is not installed."""

    def __init__(self, folder: Path) -> None:
        self._writer: Any = None
        self._folder = folder
        if find_spec("tensorboard") is not None:
            self._open()

    def _open(self, purge_step: int | None = None) -> None:
        from torch.utils.tensorboard import SummaryWriter

        self._writer = SummaryWriter(str(self._folder), purge_step=purge_step)

    def rewind(self, step: int) -> None:
        """Let TensorBoard hide the points after a step."""
        if self._writer is not None:
            self._writer.close()
            self._open(step + 1)

    def add(self, step: int, row: Mapping[str, float]) -> None:
        """Add one point to the curve of each column."""
        if self._writer is not None:
            for name, value in row.items():
                self._writer.add_scalar(name, value, step)

    def close(self) -> None:
        """Flush and close the file."""
        if self._writer is not None:
            self._writer.close()
