"""Write the tables of pages that come from files of results/: `python -m lab tables`.

A page says between which comments a table stands, which file of results/ it is taken from, and
which part of that file is shown:

    <!-- table: results/hexapod/report.md; rows: sac | linear; columns: policy | return | SOPs -->

    | policy | return | SOPs |
    …

    <!-- end of table -->

`rows` are names in the first column, in the order of the page; without it all rows are shown.
`columns` are heads in the order of the page; without it all of the file's table. Cells are
copied as they stand in the file. A file may hold several tables: a row is looked up in all of them
that begin with the same head.

A command instead of a file, as in `table: spikedeploy chips --markdown`, prints the table itself.
"""

import argparse
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from spikedeploy.reports.table import ABSENT, markdown_text
from spikedeploy.runtime.files import write_text

ROOT = Path(__file__).resolve().parents[1]
_BLOCK = re.compile(r"(<!-- table: ([^>]*?) -->\n\n)(?:\|.*\n)*(\n?<!-- end of table -->)")


class TableError(Exception):
    """A comment that asks for what no file of results has; one sentence."""


class MarkdownTable(NamedTuple):
    """A table in Markdown: heads of its columns, and rows as wide as these."""

    heads: list[str]
    rows: list[list[str]]


def pages() -> list[Path]:
    """Pages that may hold tables of results."""
    places = ("README.md", "results/closed-loop.md", "docs/**/*.md")
    return [page for place in places for page in sorted(ROOT.glob(place))]


def parse_tables(text: str) -> Iterator[MarkdownTable]:
    """Yield every table of a text in Markdown."""
    for block in re.findall(r"(?:^\|.*\n?)+", text, re.MULTILINE):
        heads, *lines = [
            [cell.strip() for cell in line.strip().strip("|").split("|")]
            for line in block.splitlines()
        ]
        yield MarkdownTable(heads, lines[1:])  # the first line rules off the heads


def join_tables(found: list[MarkdownTable], columns: list[str]) -> MarkdownTable:
    """Return the first table that has the columns, or rows of several that begin with one head.

    Raises TableError where no table, or no row of joined tables, has a column.
    """
    for table in found:
        if set(columns) <= set(table.heads):
            return table
    cells: dict[str, dict[str, str]] = {}
    for table in found:
        if table.heads[0] == columns[0]:
            for row in table.rows:
                cells.setdefault(row[0], {}).update(zip(table.heads, row, strict=True))
    missing = [head for head in columns if not any(head in row for row in cells.values())]
    if missing:
        raise TableError(f"there is no column {missing[0]!r}")
    return MarkdownTable(
        columns, [[row.get(head, ABSENT) for head in columns] for row in cells.values()]
    )


def select(table: MarkdownTable, rows: list[str], columns: list[str]) -> MarkdownTable:
    """Return the rows with these names in the first column, and these columns, in this order."""
    named = {row[0]: row for row in table.rows}
    if missing := [name for name in rows if name not in named]:
        raise TableError(f"there is no row {missing[0]!r}, only {', '.join(named)}")
    places = [table.heads.index(head) for head in columns]
    chosen = [named[name] for name in rows] if rows else table.rows
    return MarkdownTable(columns, [[row[place] for place in places] for row in chosen])


def make_table(request: str) -> str:
    """Return the table that a comment asks for.

    Raises TableError where the file, a row or a column is missing.
    """
    if request.startswith("spikedeploy "):
        words = [sys.executable, "-m", *request.split()]
        return subprocess.run(words, capture_output=True, text=True, check=True, cwd=ROOT).stdout
    file, *parts = [part.strip() for part in request.split(";")]
    options = {name.strip(): _names(text) for name, _, text in (p.partition(":") for p in parts)}
    if unknown := options.keys() - {"rows", "columns"}:
        raise TableError(f"{min(unknown)!r} is none of rows, columns")
    if not (ROOT / file).is_file():
        raise TableError(f"there is no {file}")
    found = list(parse_tables((ROOT / file).read_text(encoding="utf-8")))
    columns = options.get("columns") or found[0].heads
    made = select(join_tables(found, columns), options.get("rows", []), columns)
    return markdown_text([made.heads, *made.rows]) + "\n"


def fill_page(text: str) -> str:
    """Return a page with its tables written anew from results/."""

    def written(match: re.Match[str]) -> str:
        try:
            return match[1] + make_table(match[2]) + match[3]
        except TableError as error:
            raise TableError(f"{match[2]}: {error}") from None

    return _BLOCK.sub(written, text)


def main() -> int:
    """Write all pages anew, or with --check name those that would change."""
    parser = argparse.ArgumentParser(prog="python -m lab tables", description=__doc__)
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("--check", action="store_true", help="write nothing; exit 1 for a change")
    check = parser.parse_args().check
    changed = 0
    for page in pages():
        text = page.read_text(encoding="utf-8")
        try:
            made = fill_page(text)
        except TableError as error:
            print(f"error: {page.relative_to(ROOT)}: {error}", file=sys.stderr)
            return 1
        if made != text:
            changed += 1
            print(f"{page.relative_to(ROOT)}: {'differs' if check else 'written'}")
            if not check:
                write_text(page, made)
    return int(check and changed > 0)


def _names(text: str) -> list[str]:
    return [name.strip() for name in text.split("|")]
