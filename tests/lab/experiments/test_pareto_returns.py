"""The table of returns over training seeds and episodes, of rows as the CSV holds them."""

import numpy as np
import pytest

from lab.experiments.pareto import records
from lab.experiments.pareto.fronts import earned, points, score
from lab.experiments.pareto.levels import return_table
from spikedeploy.comparison.statistics import iqm, risk

EPISODES = 40
SKILLS = (3000.0, 3200.0, 3400.0)  # of three trainings


def walks(student, seed, skill):
    """A row of one training, the same episodes hard for all."""
    hard = np.random.default_rng(0).normal(0, 100, EPISODES)
    found = {"student": student, "seed": seed, "level": 50, "place": "loihi1", "part": "levels"}
    returns = (skill + hard).tolist()
    counts = {"operations": 50.0, "falls": 0.0, "crashes": None, "neuron_updates": 26.0}
    return found | counts | {"scores": returns, "return_mean": float(np.mean(returns))}


@pytest.fixture
def walked():
    alone = {"level": None, "part": None, "place": "hexapod/sac"}
    teacher = walks("teacher", None, 3300.0) | alone
    return [teacher, *(walks("sparse", seed, skill) for seed, skill in enumerate(SKILLS))]


def drives(row):
    finishes = [float(each > 3000) for each in row["scores"]]
    return row | {"crashes": 0.5, "scores": finishes}


def test_mean_iqm_and_risk_are_of_all_trainings_together_with_their_spread(walked):
    (point,) = points(walked)
    found, everything = earned(point.rows), np.concatenate([r["scores"] for r in walked[1:]])
    assert found.mean.mean == pytest.approx(everything.mean())
    assert found.iqm.mean == pytest.approx(iqm(everything))
    assert found.risk.mean == pytest.approx(risk(everything))
    alone = earned(point.rows[:1]).mean.ci95
    assert found.mean.ci95[1] - found.mean.ci95[0] > 3 * (alone[1] - alone[0])


def test_each_level_has_a_row_with_its_training_seeds_and_the_teacher_one_without(walked):
    lines = return_table(walked, points(walked)).splitlines()
    assert lines[0] == "| policy | aim | training seeds | episodes | return | IQM | risk |"
    assert lines[2].startswith("| LIF | 50 | 3 | 40 | 3,194 [")
    assert lines[3].startswith("| teacher, hexapod/sac | – | – | 40 | 3,294 [")


def test_karts_have_finishes_first_and_returns_where_their_rows_keep_them(walked):
    karts = [drives(row) for row in walked]
    assert earned(karts[1:]) is None
    assert score(karts[1:]).mean == np.mean([row["scores"] for row in karts[1:]])
    assert return_table(karts, points(karts)).splitlines()[0].endswith("| episodes | finished |")
    kept = [kart | {"returns": row["scores"]} for kart, row in zip(karts, walked, strict=True)]
    assert earned(kept[1:]) == earned(walked[1:])
    head = return_table(kept, points(kept)).splitlines()[0]
    assert head.endswith("| finished | return | IQM | risk |")


def test_a_csv_counts_the_trainings_of_each_policy(walked, tmp_path):
    plain = [row | {"neuron_updates": None, "operations": None} for row in walked]
    found = records.read(records.write(plain, tmp_path / "hexapod.csv"))
    assert [row["training_seeds"] for row in found] == [None, 3, 3, 3]
