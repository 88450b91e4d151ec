"""docs/leaderboard.md is made of the rows in results/leaderboard, and ours of results."""

import pytest

from lab import leaderboard
from lab.experiments import hidden_neurons
from spikedeploy import zoo
from spikedeploy.envs import spec
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


COLUMNS = leaderboard._COLUMNS


@pytest.mark.parametrize("name", [name for name in ROWS if name.startswith(leaderboard.OWN)])
def test_success_early_ends_and_the_worst_episodes_stand_beside_every_return(name):
    row = ROWS[name]
    for column in ("success", "ended early", "worst 5 %"):
        assert "%" in COLUMNS[column](row)
    assert f"{row.over_trainings.success_rate:.1%}; {row.reference} " in COLUMNS["success"](row)
    assert row.spiking.success_rate + row.spiking.failure_rate <= 1
    assert row.spiking.risk <= row.spiking.return_mean


def test_a_policy_that_does_not_need_its_hidden_neurons_is_called_linear_in_events():
    linear = {name: hidden_neurons.is_linear(row) for name, row in hidden_neurons.read().items()}
    told = {row.task: COLUMNS["policy"](row) for row in ROWS.values()}
    for task in ("kart-grid", "kart-steer", "kart-gazebo"):
        name = f"{task}/sparse"
        assert ("linear in events" in told[spec(task).id]) is linear[name]
        assert "of its return with all hidden neurons dead" in told[spec(task).id]
        page = zoo.path(name).with_suffix(".md").read_text("utf-8")
        assert ("linear in events" in page) is linear[name]
    assert [name for name, of in linear.items() if of] == ["kart-grid/sparse"]


@pytest.mark.parametrize(
    ("kept", "interval", "begins"),
    [
        (1.0, (0.0, 0.03), "linear in events: with"),
        (0.98, (-0.02, 0.01), "linear in events: with"),
        (0.979, (-0.02, 0.01), "with"),  # of the return too little, of success nothing is shown
        (0.99, (-0.12, -0.01), "needed: with"),  # success falls
        (0.1, (-0.95, -0.84), "needed: with"),
    ],
)
def test_neurons_are_needed_where_success_falls_without_them(kept, interval, begins):
    row = hidden_neurons.read()["kart-steer/sparse"]
    row |= {"kept": kept, "success_difference_ci95": list(interval)}
    assert hidden_neurons.describe(row).startswith(f"{begins} all hidden neurons dead")


@pytest.mark.parametrize("policy", hidden_neurons.read())
def test_a_card_says_what_the_table_of_hidden_neurons_has(policy):
    row = hidden_neurons.read()[policy]
    assert zoo.card(policy)["hidden_neurons"] == hidden_neurons.describe(row)
    assert row["hidden_spikes"] > 0  # they spike, needed or not


def test_a_row_of_ours_stands_beside_a_float_policy_of_nearly_equal_return():
    for name, row in ROWS.items():
        if name.startswith(leaderboard.OWN):
            assert row.rival.share > 0.98
            assert row.rival.effective_macs
