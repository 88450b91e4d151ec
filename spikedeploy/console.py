"""Standard output and error: tables and JSON on stdout, progress and remarks on stderr."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING

from spikedeploy.files import as_text

if TYPE_CHECKING:
    from rich.console import Console

_PIPE_WIDTH = 120


def print_json(data: object) -> None:
    """Write `data` as JSON, and nothing else."""
    print(as_text(data), end="")


def say(line: str) -> None:
    """Write a line on stderr, which leaves stdout for results."""
    console(stderr=True).print(line, markup=False)


def print_table(
    title: str, columns: Sequence[str], rows: Iterable[Sequence[str]], numbers: bool = False
) -> None:
    """Write a table; with `numbers` every column after the first is right-aligned."""
    from rich import box
    from rich.markup import escape
    from rich.table import Table

    table = Table(
        title=title, title_justify="left", title_style="bold", box=box.SIMPLE_HEAD, pad_edge=False
    )
    for place, column in enumerate(columns):
        table.add_column(
            escape(column),
            justify="right" if numbers and place else "left",
            no_wrap=numbers and not place,
        )
    for row in rows:
        table.add_row(*row)
    console().print(table)


def console(stderr: bool = False) -> "Console":
    """A console as wide as the terminal, or `PIPE_WIDTH` columns where there is none."""
    from rich.console import Console

    made = Console(stderr=stderr, highlight=False)
    if not made.is_terminal:
        made.width = _PIPE_WIDTH
    return made


@contextmanager
def progress(description: str, total: int) -> Iterator[Callable[[], None]]:
    """A progress bar on stderr, and the function that advances it by one."""
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TimeRemainingColumn

    columns = ("{task.description}", BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console(stderr=True), transient=True) as bar:
        task = bar.add_task(description, total=total)
        yield lambda: bar.advance(task)
