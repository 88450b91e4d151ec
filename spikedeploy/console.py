"""Standard output and error: results on stdout, progress and remarks on stderr."""

import codecs
import io
import os
import shlex
import sys
import textwrap
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from spikedeploy.runtime.files import as_text

if TYPE_CHECKING:
    from rich.console import Console

_PIPE_WIDTH = 120
PAUSE = 10.0  # seconds between two lines of progress where there is no terminal
# for terminals that know ASCII alone
_ASCII = {
    "–": "-", "−": "-", "·": "-", "…": "...", "→": "->", "≥": ">=", "≤": "<=", "±": "+-", "×": "x",
    "µ": "u", "✓": "+", "✗": "x", "≠": "!=", "“": '"', "”": '"', "’": "'",
}  # fmt: skip


def prepare_streams() -> None:
    """Flush each line, also into a pipe, and spell out letters that a terminal lacks."""
    codecs.register_error("ascii-spelling", _spell_in_ascii)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(line_buffering=True, errors="ascii-spelling")


def _spell_in_ascii(error: UnicodeError) -> tuple[str, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    letters = error.object[error.start : error.end]
    return "".join(_ASCII.get(letter, "?") for letter in letters), error.end


def discard_output() -> None:
    """Discard output that cannot be written, so that the interpreter does not try at exit."""
    try:
        sys.stdout.flush()
    except OSError:
        with open(os.devnull, "w") as nothing:
            os.dup2(nothing.fileno(), sys.stdout.fileno())


def program_name() -> str:
    """The name by which the user calls this program; the script ./spike sets it."""
    return shlex.quote(os.environ.get("SPIKEDEPLOY_COMMAND") or "spikedeploy")


def name_program(text: str) -> str:
    """The text with `spikedeploy …` as the user calls it."""
    return text.replace("`spikedeploy ", f"`{program_name()} ")


def print_json(data: object) -> None:
    """Write `data` as JSON, and nothing else."""
    print(as_text(data), end="")


def print_result(json: bool, record: object, *lines: str) -> None:
    """Write a record as JSON, or else lines."""
    if json:
        print_json(record)
    elif lines:
        print("\n".join(lines))


def say(line: str) -> None:
    """Write a line on stderr, which leaves stdout for results."""
    console(stderr=True).print(
        name_program(line), markup=False, soft_wrap=True
    )  # so that it can be copied


def print_text(text: str) -> None:
    """Write text on stdout as it is, wrapped between words."""
    console().print(text, markup=False)


def print_list(items: Iterable[str]) -> None:
    """Write items on stdout, each behind a dash, wrapped between words."""
    for item in items:
        print(
            textwrap.fill(
                item,
                console().width,
                initial_indent="- ",
                subsequent_indent="  ",
                break_on_hyphens=False,
                break_long_words=False,
            )
        )


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
        yield _lines(description, total)
        return
    from rich.markup import escape
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TimeRemainingColumn

    columns = ("{task.description}", BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=screen, transient=True) as bar:
        task = bar.add_task(escape(description), total=total)
        yield lambda: bar.advance(task)


def _lines(description: str, total: int) -> Callable[[], None]:
    done, printed = 0, time.monotonic()

    def advance() -> None:
        nonlocal done, printed
        done += 1
        if time.monotonic() - printed >= PAUSE:
            printed = time.monotonic()
            say(f"{description}: {done} of {total}")

    return advance
