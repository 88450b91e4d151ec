"""Tables on the terminal, in Markdown and on pages, and the formats of their cells."""

import csv
import json
import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import zip_longest
from pathlib import Path
from typing import Any, NamedTuple

from markupsafe import Markup

from spikedeploy.console import screen_width, wrap
from spikedeploy.runtime.files import replacing

Row = Mapping[str, Any]
Cell = Callable[[Row], str]
ABSENT = "–"
COMMON_TABLE = "horowitz45-int8"  # the one that prices a chip and a float network alike
_GAP = 2  # letters between two columns on the terminal
_SHORTEST_NAME, _LONGEST_NAME = 16, 40  # letters of a row's name that are not broken
_LONGEST_CELL = 44  # letters that a page does not break
_LONGEST_NUMBER = 30  # letters that a terminal does not break: a number with its interval
_NUMBER = re.compile(r"[-−+±≥≤<>≈*\[( ]*\d")
_PREFIXES = {1: "", 1e-3: "m", 1e-6: "µ", 1e-9: "n"}


@dataclass(frozen=True)
class Column:
    """A column of a table of records: its head, its definition, and a record's cell."""

    title: str
    meaning: str
    cell: Cell


class HeadlineNumber(NamedTuple):
    """A number of the headline: what it is, the number, and what stands beside it."""

    title: str
    number: str
    beside: tuple[str, ...]


@dataclass(frozen=True)
class Table:
    """Rows of cells.

    columns: (n,) their heads
    rows: rows of n cells each
    title: for the terminal
    numbers: whether the terminal shows every column after the first at the right
    meanings: head -> definition, which pages show under the pointer
    kinds: CSS class of each row, for pages
    """

    columns: Sequence[str]
    rows: Sequence[Sequence[str]]
    title: str = ""
    numbers: bool = False
    meanings: Mapping[str, str] = field(default_factory=dict)
    kinds: Sequence[str] = ()

    @classmethod
    def from_records(
        cls,
        columns: Sequence[Column],
        records: Sequence[Row],
        title: str = "",
        kinds: Sequence[str] = (),
    ) -> "Table":
        """The table of some records, whose columns after the first are numbers."""
        heads = [column.title for column in columns]
        cells = [[column.cell(record) for column in columns] for record in records]
        meanings = {column.title: column.meaning for column in columns}
        return cls(heads, cells, title, True, meanings, kinds)

    @classmethod
    def from_formats(
        cls,
        forms: Mapping[str, str],
        records: Iterable[Row],
        title: str = "",
        numbers: bool = False,
    ) -> "Table":
        """The table of some records, whose cells are formats filled with the record's fields.

        forms: head -> format
        """
        rows = [[form.format_map(record) for form in forms.values()] for record in records]
        return cls(tuple(forms), rows, title, numbers)

    def print(self, width: int | None = None) -> None:
        """Write the table on stdout, in at most so many columns of the terminal; None for all."""
        print("\n".join(self.lines(min(width or screen_width(), screen_width()))))

    def lines(self, wide: int) -> Iterator[str]:
        """The lines of the table; one of numbers that is too wide in blocks of columns."""
        widths = self._widths(wide)
        if self.title:
            yield self.title
        for block in self._blocks(widths, wide):
            fitted = _fit([widths[place] for place in block], wide)
            sides = [">" if self.numbers and place else "<" for place in block]
            head, *rows = ([row[place] for place in block] for row in (self.columns, *self.rows))
            yield from _lines_of(head, fitted, sides)
            yield "─" * (sum(fitted) + _GAP * (len(block) - 1))
            for row in rows:
                yield from _lines_of(row, fitted, sides)
            yield ""

    def _widths(self, wide: int) -> list[int]:
        """Width of each column before it is fitted; heads break between words."""
        columns = list(zip(self.columns, *self.rows, strict=True))
        widths = [max(map(len, column)) for column in columns]
        if not self.numbers or sum(widths) + _GAP * (len(widths) - 1) <= wide:
            return widths
        for place, (head, *cells) in enumerate(columns[1:], 1):
            words = [word for text in (head, *cells) for word in text.split()]
            widest = min(max(map(len, cells), default=0), _LONGEST_NUMBER)
            widths[place] = max([widest, *map(len, words)])
        left = wide - sum(widths[1:]) - _GAP * (len(widths) - 1)
        return [min(widths[0], left if left >= _SHORTEST_NAME else _LONGEST_NAME), *widths[1:]]

    def _blocks(self, widths: Sequence[int], wide: int) -> Iterator[list[int]]:
        """Columns that fit beside the first; of a table of texts all."""
        block = [0]
        for place in range(1, len(widths)):
            taken = sum(widths[each] + _GAP for each in block) + widths[place]
            if self.numbers and len(block) > 1 and taken > wide:
                yield block
                block = [0]
            block.append(place)
        yield block

    def markdown(self) -> str:
        """The table as lines of Markdown; its cells are Markdown already."""
        rows = [self.columns, ["---"] * len(self.columns), *self.rows]
        return "\n".join(f"| {' | '.join(row)} |" for row in rows)

    @cached_property
    def classes(self) -> list[str]:
        """The CSS class of each column: `words`, at the left, or none for numbers."""
        columns = zip(*self.rows, strict=True) if self.rows else [()] * len(self.columns)
        return [
            "words" if place == 0 or _has_words(cells) else ""
            for place, cells in enumerate(columns)
        ]

    def cell_class(self, column: int, cell: str) -> str:
        """The CSS class of a cell in a column; lines of `text` break."""
        return "text" if len(_text(cell)) > _LONGEST_CELL else self.classes[column]


def _text(cell: str) -> str:
    return cell.striptags() if isinstance(cell, Markup) else cell


def _fit(widths: list[int], wide: int) -> list[int]:
    """The widths, of which the widest shrink until all fit."""
    while sum(widths) + _GAP * (len(widths) - 1) > wide and max(widths) > 1:
        widths[widths.index(max(widths))] -= 1
    return widths


def _break(cell: str, width: int) -> list[str]:
    """The lines of a cell; a word that is too long is cut."""
    lines = [line for part in cell.split("\n") for line in wrap(part, width)]
    return [line[k : k + width] for line in lines for k in range(0, len(line) or 1, width)]


def _lines_of(cells: Sequence[str], widths: Sequence[int], sides: Sequence[str]) -> Iterator[str]:
    """The lines of a row, as many as its longest cell takes."""
    broken = [_break(cell, width) for cell, width in zip(cells, widths, strict=True)]
    for lines in zip_longest(*broken, fillvalue=""):
        shown = zip(lines, sides, widths, strict=True)
        yield (" " * _GAP).join(f"{line:{side}{width}}" for line, side, width in shown).rstrip()


def _has_words(cells: Sequence[str]) -> bool:
    """True if most cells with any content are no numbers."""
    filled = [text for text in map(_text, cells) if text not in ("", ABSENT)]
    return sum(_NUMBER.match(text) is not None for text in filled) * 2 < len(filled)


def markdown_text(lines: Sequence[Sequence[str]]) -> str:
    """The Markdown of a table whose first line is its head."""
    return Table(lines[0], lines[1:]).markdown()


def write_rows(records: Iterable[Row], columns: Sequence[str], path: Path) -> Path:
    """Write records as CSV; missing fields stay empty, a field without a column raises ValueError.

    Floats have 10 digits; a list is JSON, with 7 digits.
    """
    with replacing(path) as part, part.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, columns, lineterminator="\n", extrasaction="raise")
        writer.writeheader()
        writer.writerows({name: _csv_cell(value) for name, value in row.items()} for row in records)
    return path


def _csv_cell(value: object) -> object:
    if isinstance(value, list):
        return json.dumps([float(f"{each:.7g}") for each in value], separators=(",", ":"))
    return f"{value:.10g}" if isinstance(value, float) else value


def escape_markdown(name: str) -> str:
    """A user's name as plain Markdown: no markup, no end of a cell or line."""
    return re.sub(r"([\\`*_\[\]<>|#])", r"\\\1", " ".join(name.split()))


def price_cell(name: str, table: str, unit: str, interval: str) -> Cell:
    """A cell with an estimate by an energy table, with an SI prefix.

    interval: field with the bounds
    """

    def cell(row: Row) -> str:
        value = row[name].get(table)
        if value is None:
            return ABSENT
        low, high = row.get(interval, {}).get(table, (0, None))
        return format_bounds(f"{format_si(value)}{unit}", value, low, high)

    return cell


def format_bounds(text: str, value: float, low: float, high: float | None) -> str:
    """A number with its bounds: `≥ 3.2 µJ`, `3.2 µJ ± 11.7 %`, `2.1 µJ to 9.8 µJ`."""
    if high is None or math.isinf(high):
        return f"≥ {text}" if low == value else text
    if low == high:
        return text
    if math.isclose(value - low, high - value, rel_tol=1e-6):
        return f"{text} ± {100 * (high - value) / value:.3g} %"
    unit = text[-1]
    highest = f"{format_si(high)}{unit}"
    return f"≤ {highest}" if low == 0 else f"{format_si(low)}{unit} to {highest}"


def format_si(value: float) -> str:
    """The number with an SI prefix, so that it is between 0.1 and 99: `13.03 µ`."""
    size = next((size for size in _PREFIXES if value >= 0.1 * size), 1e-9)
    return f"{value / size:.2f} {_PREFIXES[size]}"
