"""Progress of a training, for people: a bar on a terminal, lines elsewhere."""

import sys
import time
from collections.abc import Iterable, Mapping
from contextlib import suppress
from datetime import timedelta

from rich.console import Console, RenderableType
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
from rich.text import Text

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
