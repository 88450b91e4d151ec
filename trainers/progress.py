"""Progress of a training: a bar on a terminal, and signals that ask to stop."""

import signal
import sys
import threading
import time
from collections.abc import Iterable, Mapping
from contextlib import suppress
from datetime import timedelta
from types import FrameType
from typing import Any

from rich.console import Console, RenderableType
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
from rich.text import Text

# metrics below the bar, and their formats, the most wanted first
_SHOWN = {
    "episode_return": "return {:,.0f}",
    "eval_return": "validation {:,.0f}",
    "best": "best {:,.0f}",
    "train_loss": "loss {:.3g}",
    "eval_accuracy": "validation {:.1%}",
    "best_accuracy": "best {:.1%}",
    "eval_error": "validation error {:.3f}",
    "best_error": "best {:.3f}",
    "eval_success": "success {:.0%}",
    "spike_rate": "spikes {:.1%}",
    "steps_per_s": "{:,.0f} steps/s",
    "updates_per_s": "{:,.0f} updates/s",
    "phase": "phase {:.0f}",
    "walks": "{:,.0f} walks",
    "operations": "about {:,.0f} operations",  # expected, not counted on a chip
}
PAUSE = 10.0  # seconds between two lines where there is no terminal
# SIGTERM is what schedulers and `kill` send, SIGHUP a terminal that is closed; Windows lacks both
_SIGNALS = ("SIGINT", "SIGTERM", "SIGHUP")


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
        self._printed = time.monotonic()
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
        self.say(self._title)
        self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        with suppress(OSError):  # a terminal that was closed takes nothing, and training goes on
            self._bar.stop()

    def say(self, line: str) -> None:
        """Write a line above the bar."""
        if not self._quiet:
            self._screen.print(line, markup=False, soft_wrap=True)

    def show(self, row: Mapping[str, float]) -> None:
        """Show the returns and speed of a row of metrics."""
        self._latest.update({key: row[key] for key in _SHOWN if key in row})

    def move_to(self, step: int, total: int) -> None:
        """Set the bar to a step; the last of several at once may go beyond the total."""
        step = min(step, total)
        count = f"{step:,} / {total:,}"
        with suppress(OSError):
            self._bar.update(self._task, completed=step, total=total, count=count)
            speed, latest = self._bar.tasks[self._task].speed, dict(self._latest)
            if speed is not None:  # of the last half minute; a row's is of the steps before it
                latest |= {name: speed for name in latest if name.endswith("_per_s")}
            known = (key for key in _SHOWN if key in latest)
            self._bar.note = "  ".join(_SHOWN[key].format(latest[key]) for key in known)
            paused = time.monotonic() - self._printed >= PAUSE
            if paused and not (self._quiet or self._screen.is_terminal):
                self._printed = time.monotonic()
                left = self._bar.tasks[self._task].time_remaining
                time_left = "" if left is None else f"{timedelta(seconds=round(left))} left"
                parts = count, f"{100 * step / total:.0f} %", time_left, self._bar.note
                print("  ".join(filter(None, parts)), file=sys.stderr, flush=True)


class Interrupt:
    """While entered, Ctrl-C (SIGINT), SIGTERM and SIGHUP request a stop; a second one ends at once.

    requested: number of the signal that came, 0 for none
    share: part of the training that is done, where it stopped before its end
    bar: where it is acknowledged at once; None for nowhere
    """

    def __init__(self) -> None:
        self.requested = 0
        self.share: float | None = None
        self.bar: ProgressBar | None = None
        self._before: dict[int, Any] = {}

    def __call__(self) -> bool:
        """Return whether a stop was requested."""
        return bool(self.requested)

    @property
    def exit_code(self) -> int:
        """Exit code that shells return for the signal: 130, 143 or 129."""
        return 128 + (self.requested or signal.SIGINT)

    def __enter__(self) -> "Interrupt":
        if threading.current_thread() is threading.main_thread():  # elsewhere Python forbids it
            for name in _SIGNALS:
                number = getattr(signal, name, None)
                before = signal.getsignal(number) if number is not None else None
                # SIGHUP is none to listen to where nohup has it ignored
                ignored = before == signal.SIG_IGN and name != "SIGINT"
                if number is not None and before is not None and not ignored:
                    self._before[number] = signal.signal(number, self._request)
        return self

    def __exit__(self, *_: object) -> None:
        for number, before in self._before.items():
            signal.signal(number, before)
        self._before, self.bar = {}, None

    def _request(self, number: int, frame: FrameType | None) -> None:
        if self.requested:
            raise KeyboardInterrupt
        self.requested = number
        if self.bar is not None:
            with suppress(OSError):  # of a terminal that was closed
                self.bar.say("stopping after this step … (Ctrl-C again stops at once)")
