"""Every number in tables of results, of README and docs, stands in the file of results/ they name.

A table of results is one whose paragraph links to results/. Its rows are looked up by their names,
the columns before the first number, and its cells by the names of their columns.
"""

import re
from typing import NamedTuple

import pytest

from tests.paths import ROOT

README = ROOT / "README.md"
PAGES = (README, ROOT / "docs/results.md", ROOT / "docs/sparse.md")
LINK = re.compile(r"\]\((?:\.\./)?(results/[^)#]+\.md)[^)]*\)")
NUMBER = re.compile(r"[-+≥≤±~]?\s?\d")
NOTHING = {"–", "-", ""}


class Table(NamedTuple):
    """Of a page: the paragraph before it, the heads of its columns, its rows."""

    before: str
    heads: list[str]
    rows: list[list[str]]


def cells(line):
    return [re.sub(r"[*`]", "", cell).strip() for cell in line.strip().strip("|").split("|")]


def tables(text):
    """Every table of a page in Markdown."""
    blocks = [block.strip() for block in re.split(r"\n\s*\n", text)]
    for before, block in zip(["", *blocks], blocks, strict=False):
        lines = block.splitlines()
        if block.startswith("|") and len(lines) > 2:
            heads, _, *rows = map(cells, lines)
            yield Table(before, heads, rows)


def results(text):
    """Tables of a page that name files of results, and those files."""
    for table in tables(text):
        if files := LINK.findall(table.before):
            yield table, [ROOT / file for file in files]


def names(row):
    """How many cells of a row stand before its first number: they say which row it is."""
    return next((k for k, cell in enumerate(row) if cell in NOTHING or NUMBER.match(cell)), 0)


def same_name(name, other):
    """Whether a row's name means another's: `snn` of a file is every `snn · …` of the README."""
    return name == other or name.startswith(f"{other} · ")


def same_head(head, other):
    """Whether columns are the same: the README may shorten or extend what a file calls one."""
    return head in other or other in head


def known(table, row, files):
    """(head, cell) of each cell of the files' rows that have the names of the README's row."""
    wanted = row[: names(row)]
    for file in files:
        for found in tables(file.read_text("utf-8")):
            for theirs in found.rows:
                labels = [*theirs, file.stem, file.parent.name]
                if all(any(same_name(name, label) for label in labels) for name in wanted):
                    yield from zip(found.heads, theirs, strict=True)


def untied(text):
    """Cells with a number that no file of results has: 'row, column: cell'."""
    for table, files in results(text):
        for row in table.rows:
            there = list(known(table, row, files))
            for head, cell in list(zip(table.heads, row, strict=True))[names(row) :]:
                near = [value for other, value in there if same_head(head, other)]
                if cell not in NOTHING and cell not in near:
                    yield f"{' '.join(row[: names(row)])}, {head}: {cell}"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_number_in_a_table_of_results_stands_in_the_file_that_the_page_names(page):
    text = page.read_text("utf-8")
    assert list(results(text))
    assert list(untied(text)) == []


def test_the_readme_has_results_and_each_of_their_tables_names_its_file():
    text = README.read_text("utf-8")
    (section,) = re.findall(r"^## Results\n(.*?)(?=^## |\Z)", text, re.MULTILINE | re.DOTALL)
    assert list(tables(section))
    assert all(LINK.search(table.before) for table in tables(section))


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
@pytest.mark.parametrize("digit", [re.compile(r"\d(?=\D*$)"), re.compile(r"\d")])
def test_a_digit_that_is_changed_in_any_cell_is_found(digit, page):
    text = page.read_text("utf-8")
    for table, _ in results(text):
        for row in table.rows:
            for k in range(names(row), len(row)):
                if not NUMBER.match(row[k]):
                    continue
                wrong = [*row]
                wrong[k] = digit.sub(lambda m: str((int(m[0]) + 1) % 10), row[k], count=1)
                lines = [table.before, ""]
                lines += [f"| {' | '.join(each)} |" for each in (table.heads, ["-"] * 2, wrong)]
                assert list(untied("\n".join(lines)))
