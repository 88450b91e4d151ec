"""docs/leaderboard.md is made of the rows in results/leaderboard, and ours of results."""

import pytest

from lab import leaderboard
from spikedeploy.shipping.leaderboard import faults, plain
from tests.paths import ROOT

PAGE = (ROOT / "docs/leaderboard.md").read_text("utf-8")
ROWS = leaderboard.all_rows()


def test_the_page_has_the_tables_of_its_rows():
    assert leaderboard.filled(PAGE, ROWS) == PAGE


@pytest.mark.parametrize("name", ROWS)
def test_a_row_is_right(name):
    assert list(faults(ROWS[name])) == []


def rounded(value):
    """A row with floats of 9 digits, as sums differ in their last bits from machine to machine."""
    if isinstance(value, dict):
        return {key: rounded(each) for key, each in value.items()}
    if isinstance(value, list):
        return [rounded(each) for each in value]
    return float(f"{value:.9g}") if isinstance(value, float) else value


def test_our_rows_are_those_of_the_results():
    made = {name: rounded(plain(row)) for name, row in leaderboard.own_rows()}
    assert len(made) == 5
    assert {name: rounded(plain(row)) for name, row in ROWS.items() if name in made} == made


@pytest.mark.parametrize("name", [name for name, row in ROWS.items() if row.evidence is None])
def test_a_row_of_a_publication_names_it_and_how_much_of_it_was_read(name):
    assert ROWS[name].read
    assert ROWS[name].source


def test_what_is_not_known_is_said_to_be_not_reported():
    table = leaderboard.tables(ROWS)["published"]
    (row,) = (line for line in table.splitlines() if "2411.13945" in line)
    cells = [cell.strip() for cell in row.strip("|").split("|")]
    assert cells[2:12] == ["not reported"] * 10


def test_a_row_of_ours_stands_beside_a_float_policy_of_nearly_equal_return():
    for name, row in ROWS.items():
        if name.startswith(leaderboard.OWN):
            assert row.rival.share > 0.98
            assert row.rival.effective_macs
