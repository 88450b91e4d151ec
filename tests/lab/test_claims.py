"""Figures that README and the pages quote are those of the results that they name."""

import csv
import json
import re
from itertools import chain

import numpy as np
import pytest

from spikedeploy import zoo
from tests.paths import ROOT

README = (ROOT / "README.md").read_text("utf-8")
TASKS = ("hexapod", "hexapod-command", "kart-grid", "kart-gazebo", "kart-steer")
SPECK_PAGES = (
    "README.md", "docs/boards.md", "docs/chip-models.md", "examples/kart_eye/README.md",
)  # fmt: skip


def finishes(level, way):
    """Shares of finished episodes of the trainings for Speck."""
    with (ROOT / "results/kart-eye.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    asked = ("if", level, way)
    return [
        float(row["finish_share"])
        for row in rows
        if (row["network"], row["level"], row["way"]) == asked
    ]


@pytest.mark.parametrize("page", SPECK_PAGES)
def test_where_speck_is_recommended_stands_what_its_policies_do_event_by_event(page):
    stepped, events = (finishes("ops-1e+06", way) for way in ("speck2f", "speck2f:queue=on"))
    assert len(stepped) == len(events) == 5
    text = (ROOT / page).read_text("utf-8")
    assert f"{100 * np.mean(events):.1f} %" == "0.8 %"
    assert "0.8 %" in text
    if not page.startswith("examples/"):
        assert f"{100 * np.mean(stepped):.1f} %" in text


def test_spiking_takes_so_many_times_the_energy_of_pruned_float_networks():
    wanted = {"task": "hexapod", "clock": "gated"}
    with (ROOT / "results/energy.csv").open(newline="", encoding="utf-8") as file:
        every = [row for row in csv.DictReader(file) if wanted.items() <= row.items()]
    # by its own price of an update and by those of two publications about Loihi
    published = [row for row in every if row["update_price_of"] in ("own", "sanafe", "davies2018")]
    ratios = [float(row["ratio"]) for row in published if row["encoder"] == "chip"]
    rows = [r for r in published if (r["encoder"], r["update_price_of"]) == ("chip", "own")]
    text = (ROOT / "results/pareto.md").read_text("utf-8").partition("\n## hexapod\n")[2]
    line = next(r for r in text.splitlines() if "With updates, encoder and constants: for" in r)
    most = float(re.search(r"times \([\d.]+ to ([\d.]+)\)", line)[1])
    assert f"{min(ratios):.1f} to {most:.1f} times the energy" in README
    assert max(ratios) < most
    table = json.loads((ROOT / "results/phase-table.json").read_text("utf-8"))["joules"]["all"]
    (spiking,) = (float(r["spiking_j"]) for r in rows if r["accumulator_bits"] == "none")
    assert f"{spiking / table:.0f} times that of a table over gait phases" in README


def test_students_take_so_many_times_the_energy_of_the_cheapest_float_policy():
    page = " ".join((ROOT / "results/students.md").read_text("utf-8").split())
    found = re.search(r"It is ([\d]+) to ([\d]+) times and ([\d]+) to ([\d]+) times in the 6", page)
    by_table = [int(each) for each in found.groups()]
    assert f"{min(by_table)} to {max(by_table)} times the energy, by task and price table" in README
    assert "fewer operations than that policy in 1 of 7 tasks by the medians" in page
    assert "keeps 97 %, they take fewer operations on one task of seven" in README


def idle(task):
    """Static energy of a control step over all that happens in it, and over operations alone."""
    (row,) = (r for r in zoo.card(f"{task}/sparse")["evaluation"] if r["chip"] == "loihi1")
    terms = [row["energy_terms_j"][table] for table in ("davies2018", "sanafe")]
    powers = row["static_energy_j"].values()
    every = [power / sum(each.values()) for power in powers for each in terms]
    return every, [power / each["operations"] for power in powers for each in terms]


def span(values):
    """`0.1 to 1.0`, in millions."""
    values = list(values)
    return f"{min(values) / 1e6:.1f} to {max(values) / 1e6:.1f}"


def test_an_idle_loihi_takes_so_many_times_what_a_policy_does():
    page = (ROOT / "docs/energy.md").read_text("utf-8")
    every, alone = zip(*map(idle, TASKS), strict=True)
    assert f"takes {span(chain(*every))} million times the energy of all" in page
    assert f"alone are {span(chain(*alone))} million times less" in page
    assert f"on the walking task {span(every[0])} million times" in page
    assert f"on the walking task {span(alone[0])}." in page
    assert f"{span(every[0])} million times](docs/energy.md#static-power)" in README
