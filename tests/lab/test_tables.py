"""Tables of results/ in README and docs are those that `python -m lab tables` writes."""

import re

import pytest

from lab import tables
from lab.tables import MarkdownTable, TableError, fill_page, join_tables, make_table
from tests.paths import ROOT

HEXAPOD = "results/hexapod/report.md"
PAGES = [page for page in tables.pages() if "<!-- table:" in page.read_text("utf-8")]
# a link to results/ or the command of a report, then a table
RESULTS = re.compile(r"^[^|\n]*(?:\]\([./]*results/|`spikedeploy compare)[^|\n]*\n\n(\|)", re.M)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_the_tables_of_a_page_are_what_the_command_writes(page):
    """Write them anew with `python -m lab tables`."""
    text = page.read_text("utf-8")
    assert fill_page(text) == text


def test_a_table_below_a_link_to_results_stands_between_markers():
    assert {"README.md", "closed-loop.md", "sparse.md", "training.md"} <= {
        page.name for page in PAGES
    }
    for page in (ROOT / "README.md", ROOT / "results/closed-loop.md", ROOT / "docs/sparse.md"):
        assert not RESULTS.search(page.read_text("utf-8")), page


@pytest.mark.parametrize(
    ("request_", "says"),
    [
        ("results/none.md", "there is no results/none.md"),
        (f"{HEXAPOD}; rows: lion", "no row 'lion', only sac"),
        (f"{HEXAPOD}; columns: policy | colour", "no column 'colour'"),
        (f"{HEXAPOD}; lines: sac", "'lines' is none of rows, columns"),
    ],
)
def test_what_no_file_has_is_named(request_, says):
    with pytest.raises(TableError, match=says):
        make_table(request_)


def test_columns_of_several_tables_are_joined_by_the_name_of_the_row():
    found = [
        MarkdownTable(["policy", "x"], [["a", "1"], ["b", "2"]]),
        MarkdownTable(["other", "x"], [["a", "9"]]),
        MarkdownTable(["policy", "y"], [["b", "3"]]),
    ]
    assert join_tables(found, ["policy", "y", "x"]).rows == [["a", "–", "1"], ["b", "3", "2"]]


def test_check_names_pages_that_differ_and_writes_nothing(tmp_path, monkeypatch, capsys):
    (tmp_path / "docs").mkdir()
    (tmp_path / "table.md").write_text("| a | b |\n| - | - |\n| x | 1 |\n")
    page = tmp_path / "README.md"
    page.write_text("<!-- table: table.md -->\n\n| a |\n|---|\n\n<!-- end of table -->\n")
    before = page.read_text()
    monkeypatch.setattr(tables, "ROOT", tmp_path)
    monkeypatch.setattr("sys.argv", ["tables", "--check"])
    assert tables.main() == 1
    assert capsys.readouterr().out == "README.md: differs\n"
    assert page.read_text() == before
    monkeypatch.setattr("sys.argv", ["tables"])
    assert tables.main() == 0
    assert "| a | b |\n| --- | --- |\n| x | 1 |\n\n<!--" in page.read_text()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["README.md", "docs", "table.md"]
