"""Standard output and error: results on stdout, progress and remarks on stderr."""

import io
import os
import shlex
import shutil
import sys
import textwrap
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager

from spikedeploy.runtime.files import as_text

_PIPE_WIDTH = 120
PAUSE = 10.0  # seconds between two lines of progress where there is no terminal


def prepare_streams() -> None:
    """Flush each line, also into a pipe; what a terminal cannot write is a question mark."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(line_buffering=True, errors="replace")


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
    print(name_program(line), file=sys.stderr)


def print_text(text: str, indent: str = "") -> None:
    """Write text on stdout, wrapped between words; further lines are indented."""
    for line in text.split("\n"):
        print("\n".join(wrap(line, screen_width(), subsequent_indent=indent)))


def print_list(items: Iterable[str]) -> None:
    """Write items on stdout, each behind a dash, wrapped between words."""
    for item in items:
        print_text(f"- {item}", "  ")


def wrap(text: str, width: int, **options: str) -> list[str]:
    """The lines of a text, broken between words alone; one of an empty text."""
    words = {"break_on_hyphens": False, "break_long_words": False}
    return textwrap.wrap(text, width, **words, **options) or [""]  # type: ignore[arg-type]


def screen_width() -> int:
    """Columns of the terminal, or `_PIPE_WIDTH` where there is none."""
    if not sys.stdout.isatty():
        return _PIPE_WIDTH
    return shutil.get_terminal_size((_PIPE_WIDTH, 24)).columns


@contextmanager
def progress(description: str, total: int) -> Iterator[Callable[[], None]]:
    """Progress on stderr, and the function that advances it by one.

    One line that changes on a terminal; elsewhere a line now and then, for logs.
    """
    live = sys.stderr.isatty()
    done, began = 0, time.monotonic()
    printed = began

    def advance() -> None:
        nonlocal done, printed
        done, now = done + 1, time.monotonic()
        line = f"{description}: {done} of {total}"
        if live:
            left = (now - began) / done * (total - done)
            sys.stderr.write(f"\r\033[K{line}, {left / 60:.1f} min left")
            sys.stderr.flush()
        elif now - printed >= PAUSE:
            printed = now
            say(line)

    try:
        yield advance
    finally:
        if live:
            sys.stderr.write("\r\033[K")
