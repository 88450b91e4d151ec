"""Rows say where their energy goes: terms that add up, totals, static energy, break-even."""

import json

import pytest

from spikedeploy.comparison.comparison import static
from spikedeploy.comparison.evaluation import compare_policies, line_up
from spikedeploy.reports import comparison_page as report
from spikedeploy.reports.columns import markdown_tables, tables
from spikedeploy.reports.table import ABSENT
from spikedeploy.runtime.metrics.energy import ON_CHIP
from spikedeploy.runtime.metrics.energy_tables import TABLES
from tests import toy_stroll_env

INT8 = "horowitz45-int8"
WHERE = "Where does the energy go, in nJ?"
NEW = (
    "macs_effective", "energy_zero_skipping_j", "energy_terms_j", "energy_unknown",
    "energy_total_j", "static_energy_j", "messages_placed", "messages_placed_j",
    "break_even_sops", "break_even_sops_zero_skipping", "messages_per_inference",
    "neuron_updates_per_inference", "neuron_idle_per_inference",
)  # fmt: skip


@pytest.fixture
def rows(monkeypatch, tmp_path):
    """Rows of the float ANN, its gait, and the spiking policy on a chip and in float."""
    toy_stroll_env.ship(monkeypatch, tmp_path / "zoo")
    entries = line_up("stroll", (), ("loihi1",))
    found = compare_policies("stroll", entries, range(10_000, 10_003), processes=1)
    return report.document(found)["rows"]


def by_chip(rows, chip):
    return next(row for row in rows if row["chip"] == chip and row["kind"] != "gait")


def test_terms_add_up_in_every_row_and_table(rows):
    seen = 0
    for row in rows:
        assert row.keys() >= set(NEW)
        assert row["macs_effective"] == row["effective_macs"]
        for table, joules in row["energy_per_inference_j"].items():
            terms = row["energy_terms_j"][table]
            chip = ON_CHIP if row["kind"] == "snn" else ("operations",)
            assert sum(terms.get(t, 0) for t in chip) == pytest.approx(joules, rel=1e-12)
            assert sum(terms.values()) == pytest.approx(row["energy_total_j"][table], rel=1e-12)
            assert not terms.keys() & set(row["energy_unknown"][table])
            seen += 1
    assert seen >= 6
    json.dumps(rows)


def test_static_energy_is_that_of_a_control_step_of_the_chip(rows):
    # 104 mW of a chip, and an eighth of the 1.084 W of a board, for 20 ms
    powers = {"frady2020": pytest.approx(2.08e-3), "popsan2020": pytest.approx(2.71e-3)}
    assert by_chip(rows, "loihi1")["static_energy_j"] == powers
    assert static("truenorth", 0.02) == {}
    assert by_chip(rows, None)["static_energy_j"] == {}
    assert by_chip(rows, "float")["static_energy_j"] == {}
    assert static("loihi1:membrane_output=none", 0.02).keys() <= powers.keys()


def test_at_the_break_even_a_spiking_row_costs_what_the_ann_costs(rows):
    spiking, ann = by_chip(rows, "loihi1"), by_chip(rows, None)
    price = TABLES[INT8].joules["sop"]
    added = (spiking["break_even_sops"][INT8] - spiking["sops_per_inference"]) * price
    total = spiking["energy_total_j"][INT8] + added
    assert total == pytest.approx(ann["energy_total_j"][INT8])
    saved = ann["energy_terms_j"][INT8]["operations"] - ann["energy_zero_skipping_j"][INT8]
    fewer = spiking["break_even_sops"][INT8] - spiking["break_even_sops_zero_skipping"][INT8]
    assert fewer * price == pytest.approx(saved)
    assert ann["break_even_sops"] == {}
    assert by_chip(rows, "float")["break_even_sops"].keys() == {"horowitz45"}


def test_the_table_marks_what_is_unknown(rows):
    columns = {column.title: column.cell for column in tables(rows)[WHERE]}
    spiking, ann = by_chip(rows, "loihi1"), by_chip(rows, None)
    assert columns["encoder"](spiking) == "?"
    assert columns["no price"](spiking).endswith("spikes, encoder")
    assert columns["no price"](ann) == "activations"
    operations = ann["energy_terms_j"][INT8]["operations"]
    assert float(columns["operations"](ann)) == pytest.approx(1e9 * operations, rel=0.01)
    assert float(columns["skipping zeros"](ann)) < float(columns["operations"](ann))
    assert columns["skipping zeros"](spiking) == ABSENT
    assert columns["all known"](ann).startswith("≥ ")
    assert columns["all known"](spiking).endswith(" + ?")  # updates are no lower bound
    assert columns["static"](spiking) == "2.08 mJ (frady2020), 2.71 mJ (popsan2020)"
    assert (
        columns["static"]({**spiking, "chip": "loihi2", "static_energy_j": {}}) == "not published"
    )
    assert columns["static"](ann) == ABSENT
    assert columns["level at"](spiking).startswith("none")  # a toy ANN is cheaper than its neurons


def test_reports_without_the_new_fields_still_render(rows):
    older = [{name: value for name, value in row.items() if name not in NEW} for row in rows]
    assert WHERE not in tables(older)
    assert markdown_tables(older)
