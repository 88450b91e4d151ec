"""Rows of the public table: made of a report, and every number of them checked."""

import json
import re
from copy import deepcopy

import numpy as np
import pytest

from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.files import read_json
from spikedeploy.runtime.schema import validate
from spikedeploy.shipping import leaderboard
from spikedeploy.shipping.leaderboard import LeaderboardRow, faults, plain, row_of_report
from tests.paths import ROOT

REPORT = ROOT / "results/kart-steer"


@pytest.fixture(scope="module")
def document():
    return read_json(REPORT / "report.json")


@pytest.fixture(scope="module")
def made(document):
    """The row of the report, as plain data."""
    return plain(row_of_report(document, "results/kart-steer"))


def changed(row, path, value):
    """The row with one field changed."""
    other = deepcopy(row)
    *inside, last = path
    place = other
    for key in inside:
        place = place[key]
    place[last] = value
    return validate(LeaderboardRow, other, "the row")


def test_a_row_has_the_numbers_of_its_report(document, made):
    (row,) = [r for r in document["rows"] if (r["policy"], r["kind"], r["chip"]) == (
        "sparse-gated", "snn", "loihi1:clock=gated")]  # fmt: skip
    ann = next(r for r in document["rows"] if r["kind"] == "ann")
    spiking = made["spiking"]
    assert spiking["return_mean"] == row["return_mean"]
    assert spiking["sops"] == row["sops_per_inference"]
    assert spiking["neuron_updates"] == row["neuron_updates_per_inference"]
    assert spiking["share"] == pytest.approx(row["return_mean"] / ann["return_mean"])
    assert spiking["share_ci95"][0] <= spiking["share"] <= spiking["share_ci95"][1]
    joules = {each["prices"]: each["dynamic_j"] for each in spiking["energy"]}
    assert joules == pytest.approx(row["energy_total_j"])
    of_loihi = next(each for each in spiking["energy"] if each["prices"] == "davies2018")
    static = of_loihi["with_static_j"] - of_loihi["dynamic_j"]
    assert static == pytest.approx(row["static_energy_j"][of_loihi["static_power"]])
    assert spiking["encoder"] == "delta, on the host"


def test_the_rival_is_the_smallest_float_policy_not_shown_to_be_worse(made):
    assert made["rival"]["name"] == "linear"
    assert made["rival"]["sops"] is None


def test_where_all_float_policies_are_worse_the_best_stands_beside():
    walk = read_json(ROOT / "results/hexapod/report.json")
    rival = row_of_report(walk, "results/hexapod").rival
    trained = [r for r in walk["rows"] if r["kind"] != "snn" and r["training_seeds"]]
    assert rival.name == max(trained, key=lambda r: r["return_mean"])["policy"]


def test_a_reward_score_is_neurobenchs(document, made):
    row = next(r for r in document["rows"] if r["policy"] == "sparse-gated"
               and r["chip"] != "float")  # fmt: skip
    score = made["neurobench"]["RewardScore"]
    returns = sorted(row["returns"])
    assert score["avg"] == pytest.approx(np.mean(returns))
    assert score["std"] == pytest.approx(np.std(returns))
    assert score["risk"] == pytest.approx(np.mean(returns[: int(0.05 * len(returns))]))


def test_a_reward_score_of_few_episodes_has_no_risk(document):
    few = deepcopy(document)
    for row in few["rows"]:
        row["returns"], row["episodes"] = row["returns"][:19], 19
        row["successes"] = row["successes"][:19]
    assert row_of_report(few, "few").neurobench.reward_score.risk is None


def test_a_row_that_a_report_gives_is_right(document, made):
    row = validate(LeaderboardRow, made, "the row")
    assert list(faults(row)) == []
    assert list(leaderboard.differences(row, document, "results/kart-steer")) == []


@pytest.mark.parametrize(
    ("path", "value", "says"),
    [
        (("spiking", "sops"), 1.0, "operations are .* by the counts of the row"),
        (("spiking", "neuron_updates"), 1.0, "updates are .* by the counts of the row"),
        (("spiking", "energy", 0, "dynamic_j"), 1e-12, "terms add up to"),
        (("spiking", "energy", 0, "with_static_j"), 0.0, "is less than"),
        (("spiking", "return_mean"), 1.0, "outside of its interval"),
        (("spiking", "share"), 2.0, "outside of its interval"),
        (("spiking", "failure_rate"), 0.5, "0.99 of the episodes succeed and 0.5 end early"),
        (("spiking", "risk"), 1e9, "spiking.risk is 1e.09, above the mean"),
        (("rival", "effective_macs"), 1e9, "more than all weights have"),
        (("rival",), None, "rival is null"),
        (("evidence", "sha256", "kart-steer/linear.onnx"), "0" * 64, "the row says 0000"),
        (("evidence",), None, "evidence is null and read too"),
        (("neurobench", "RewardScore", "risk"), 1e9, "above the mean"),
    ],
)
def test_a_number_that_cannot_be_is_named(made, path, value, says):
    assert re.search(says, "\n".join(faults(changed(made, path, value))))


@pytest.mark.parametrize(
    ("path", "value"),
    [
        (("spiking", "sops"), -1.0),
        (("spiking", "sops"), float("nan")),
        (("spiking", "sops"), "many"),
        (("spiking", "success_rate"), 1.5),
        (("spiking", "return_ci95"), [1.0]),
        (("format",), 2),
        (("speed",), 1.0),
        (("evidence", "sha256", "linear.onnx"), "short"),
    ],
)
def test_what_breaks_the_schema_is_refused(made, path, value):
    with pytest.raises(ConfigError, match=r"the row: " + r"\.".join(path)):
        changed(made, path, value)


def test_a_number_that_is_not_the_reports_is_named(document, made):
    better = changed(made, ("spiking", "success_rate"), 0.5)
    (said,) = leaderboard.differences(better, document, "results/kart-steer")
    assert said.startswith("spiking.success_rate: 0.5 in the row, 0.99 ")


def test_a_report_without_a_spiking_policy_on_a_chip_gives_no_row(document):
    floats = {**document, "rows": [r for r in document["rows"] if r["kind"] != "snn"]}
    with pytest.raises(ConfigError, match="none that spikes"):
        row_of_report(floats, "floats")


def test_a_row_of_a_report_that_lacks_a_field_is_refused(document):
    old = deepcopy(document)
    del old["rows"][0]["energy_terms_j"]
    with pytest.raises(ConfigError, match="energy_terms_j: Field required"):
        row_of_report(old, "old")


def test_submit_writes_a_row_and_checks_it(tmp_path, command):
    row = tmp_path / "row.json"
    assert command("submit", REPORT, "-o", row, "--source", "us")[0] == 0
    assert json.loads(row.read_text("utf-8"))["source"] == "us"
    assert command("submit", REPORT, "-o", row)[0] == 0  # a row of its own is replaced
    assert command("submit", "--check", row)[0] == 0
    code, out, _ = command("submit", REPORT, "--check", row, "--json")
    assert code == 0
    assert json.loads(out)["passed"]


def test_submit_exits_with_1_for_a_row_that_is_wrong(tmp_path, command, made):
    row = tmp_path / "row.json"
    row.write_text(json.dumps({**made, "reference": "gap"}), "utf-8")
    code, out, _ = command("submit", REPORT, "--check", row)
    assert code == 1
    assert "reference: gap in the row, ann from the report" in out


def test_submit_refuses_what_is_no_row_and_what_is_missing(tmp_path, command):
    (tmp_path / "row.json").write_text("{}", "utf-8")
    code, _, err = command("submit", "--check", tmp_path / "row.json")
    assert (code, "format: Field required" in err) == (2, True)
    code, _, err = command("submit", REPORT)
    assert (code, "a row is made of a report" in err) == (2, True)
    code, _, err = command("submit", tmp_path, "-o", tmp_path / "other.json")
    assert (code, "has no report.json" in err) == (2, True)
