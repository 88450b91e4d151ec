"""Standard output and error: tables and JSON on stdout, progress and remarks on stderr."""

import codecs
import io
import os
import shlex
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING

from spikedeploy.files import as_text

if TYPE_CHECKING:
    from rich.console import Console
    from rich.text import Text

_PIPE_WIDTH = 120
_NAME = 26  # letters of a name that a narrow table keeps whole
PAUSE = 10.0  # seconds between two lines of progress where there is no terminal
_COLOURS = {"✓": "green", "✗": "red"}
# for terminals that know ASCII alone
_ASCII = {
    "–": "-", "−": "-", "·": "-", "…": "...", "→": "->", "≥": ">=", "≤": "<=", "±": "+-", "×": "x",
    "µ": "u", "✓": "+", "✗": "x", "≠": "!=", "“": '"', "”": '"', "’": "'",
}  # fmt: skip


def prepare_streams() -> None:
    """Let lines appear at once, piped or not, and letters that a terminal lacks be spelt out."""
    codecs.register_error("spelt", _spelt)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(line_buffering=True, errors="spelt")


def _spelt(error: UnicodeError) -> tuple[str, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    letters = error.object[error.start : error.end]
    return "".join(_ASCII.get(letter, "?") for letter in letters), error.end


def discard_output() -> None:
    """Forget what cannot be written, so that the interpreter does not try again at its end."""
    try:
        sys.stdout.flush()
    except OSError:
        with open(os.devnull, "w") as nothing:
            os.dup2(nothing.fileno(), sys.stdout.fileno())


def called() -> str:
    """The word by which the user calls this program: the script ./spike names itself."""
    return shlex.quote(os.environ.get("SPIKEDEPLOY_COMMAND") or "spikedeploy")


def as_called(text: str) -> str:
    """A text whose `spikedeploy …` are as the user calls them."""
    return text.replace("`spikedeploy ", f"`{called()} ")


def print_json(data: object) -> None:
    """Write `data` as JSON, and nothing else."""
    print(as_text(data), end="")


def say(line: str) -> None:
    """Write a line on stderr, which leaves stdout for results."""
    console(stderr=True).print(
        as_called(line), markup=False, soft_wrap=True
    )  # so that it can be copied


def print_table(
    title: str,
    columns: Sequence[str],
    rows: Iterable[Sequence[str]],
    numbers: bool = False,
    width: int | None = None,
) -> None:
    """Write a table; with `numbers` every column after the first is right-aligned.

    width  most columns of the terminal that it takes
    """
    from rich import box
    from rich.table import Table
    from rich.text import Text

    table = Table(
        title=Text(title), title_justify="left", title_style="bold", box=box.SIMPLE_HEAD,
        pad_edge=False, show_edge=not width, padding=(0, 1, 0, 0) if width else (0, 1),
    )  # fmt: skip
    cells = [list(map(_cell, row)) for row in rows]
    # names of rows stay whole, unless they are long and the table narrow: then numbers do
    whole = not width or max((len(row[0]) for row in cells), default=0) <= _NAME
    for place, column in enumerate(columns):
        table.add_column(
            Text(column),
            justify="right" if numbers and place else "left",
            no_wrap=numbers and bool(place) != whole,
            overflow="fold" if width else "ellipsis",
        )
    for row in cells:
        table.add_row(*row)
    screen = console()
    screen.print(table, width=width and min(width, screen.width))
    if width:  # the edge that wide ones end with
        screen.print()


def _cell(text: str) -> "Text":
    """A cell as it is written, whatever brackets it has; marks in their colours."""
    from rich.text import Text

    return Text(text, style=_COLOURS.get(text, ""))


def print_text(text: str) -> None:
    """Write text on stdout as it is, wrapped between words."""
    console().print(text, markup=False)


def console(stderr: bool = False) -> "Console":
    """A console as wide as the terminal, or `PIPE_WIDTH` columns where there is none."""
    from rich.console import Console

    made = Console(stderr=stderr, highlight=False)
    if not made.is_terminal:
        made.width = _PIPE_WIDTH
    return made


@contextmanager
def progress(description: str, total: int) -> Iterator[Callable[[], None]]:
    """Progress on stderr, and the function that advances it by one.

    A bar on a terminal; elsewhere a line now and then, for logs.
    """
    screen = console(stderr=True)
    if not screen.is_terminal:
        yield _Lines(description, total).advance
        return
    from rich.markup import escape
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TimeRemainingColumn

    columns = ("{task.description}", BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=screen, transient=True) as bar:
        task = bar.add_task(escape(description), total=total)
        yield lambda: bar.advance(task)


class _Lines:
    """Progress in lines, with a pause of at least PAUSE between them."""

    def __init__(self, description: str, total: int) -> None:
        self._description, self._total, self._done = description, total, 0
        self._said = time.monotonic()

    def advance(self) -> None:
        """One more is done."""
        self._done += 1
        if time.monotonic() - self._said >= PAUSE:
            self._said = time.monotonic()
            say(f"{self._description}: {self._done} of {self._total}")
