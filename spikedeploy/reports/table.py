"""Tables on the terminal (rich), in Markdown and on pages, and the formats of their cells."""

import csv
import json
import math
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from markupsafe import Markup

from spikedeploy.console import console
from spikedeploy.runtime.files import replacing

if TYPE_CHECKING:
    import rich.console
    import rich.table
    from rich.text import Text

Row = Mapping[str, Any]
Cell = Callable[[Row], str]
ABSENT = "–"
COMMON_TABLE = "horowitz45-int8"  # the one that prices a chip and a float network alike
_COLOURS = {"✓": "green", "✗": "red"}  # on the terminal
_LONGEST_NAME = 26  # letters of a row's name that a narrow table does not break
_LONGEST_CELL = 44  # letters that a page does not break
_ANY = 1_000_000  # columns: wider than any table
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
        """Write the table on stdout; one too wide for it in blocks of columns, none of them cut.

        width: most columns of the terminal that it takes; None for all
        """
        screen = console()
        wide = min(width or screen.width, screen.width)
        for block in self._blocks(width, wide, screen):
            screen.print(block, width=wide)
            if width:  # the edge that wide ones end with
                screen.print()

    def _blocks(
        self, width: int | None, wide: int, screen: "rich.console.Console"
    ) -> "Iterator[rich.table.Table]":
        """The table; or as many columns at a time as fit, the names of rows before them."""

        def fits(table: "rich.table.Table") -> bool:
            return screen.measure(table, options=screen.options.update(width=_ANY)).maximum <= wide

        whole = self._rich(width)
        if not self.numbers or fits(whole) or (width and self._is_whole(whole, wide, screen)):
            yield whole
            return
        name, *others = range(len(self.columns))
        title, block = self.title, [name]
        for place in others:
            if len(block) > 1 and not fits(self._rich(width, [*block, place], title, wide)):
                yield self._rich(width, block, title, wide)
                title, block = "", [name]
            block.append(place)
        yield self._rich(width, block, title, wide)

    def _is_whole(
        self, table: "rich.table.Table", wide: int, screen: "rich.console.Console"
    ) -> bool:
        """True if cells after the first break between words alone where the table is so wide."""
        lines = screen.render_lines(table, screen.options.update(width=wide))
        shown = Counter(word for line in lines for each in line for word in each.text.split())
        asked = Counter(word for row in self.rows for cell in row[1:] for word in cell.split())
        return asked <= shown

    def _width(self, place: int, wide: int) -> int:
        """The width of a column: heads break between words, and of cells only names and texts."""
        from rich.cells import cell_len

        cells = [row[place] for row in self.rows]
        widest = max(map(cell_len, cells), default=0)
        if place == 0:
            return max(min(widest, max(_LONGEST_NAME, wide // 3)), cell_len(self.columns[0]))
        words = [word for text in (self.columns[place], *cells) for word in text.split()]
        return max([min(widest, _LONGEST_NUMBER), *map(cell_len, words)])

    def _rich(
        self,
        width: int | None,
        block: Sequence[int] | None = None,
        title: str | None = None,
        wide: int = 0,
    ) -> "rich.table.Table":
        """The table, or a block of its columns in a terminal so wide, each with its own width."""
        from rich import box
        from rich.table import Table
        from rich.text import Text

        table = Table(
            title=Text(self.title if title is None else title), title_justify="left",
            title_style="bold", box=box.SIMPLE_HEAD, pad_edge=False,
            show_edge=not width, padding=(0, 1, 0, 0) if width else (0, 1),
        )  # fmt: skip
        # names of rows stay whole, unless they are long and the table narrow: then numbers do
        longest = max((len(row[0]) for row in self.rows), default=0)
        unbroken_names = not width or longest <= _LONGEST_NAME
        for place in range(len(self.columns)) if block is None else block:
            table.add_column(
                Text(self.columns[place]),
                justify="right" if self.numbers and place else "left",
                no_wrap=block is None and self.numbers and bool(place) != unbroken_names,
                overflow="fold",
                width=None if block is None else self._width(place, wide),
            )
        for row in self.rows:
            cells = row if block is None else [row[place] for place in block]
            table.add_row(*map(_literal, cells))
        return table

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


def _literal(cell: str) -> "Text":
    """The cell as it is, whatever brackets it has; marks in their colours."""
    from rich.text import Text

    return Text(cell, style=_COLOURS.get(cell, ""))


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


def field_cell(name: str, form: str) -> Cell:
    """A cell that formats a field, or a dash where the record lacks it."""

    def cell(row: Row) -> str:
        value = row.get(name)
        return ABSENT if value is None else format(value, form)

    return cell


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
