"""`run` and `compare` with --disturb and --fault."""

import json

import pytest

SHORT = ("--set", "max_steps=12", "--json")


def told(command, *words):
    code, out, err = command(*words, *SHORT)
    assert code == 0, err
    return json.loads(out)


def seen(document, policy="snn", chip="loihi1"):
    """What a row earned, and how often its network spiked."""
    (row,) = (r for r in document["rows"] if (r["policy"], r["chip"]) == (policy, chip))
    return row["returns"], row["spikes_per_inference"]


def test_run_is_what_it_was_at_level_0(command):
    plain = told(command, "run", "kart-grid/snn")
    calm = told(command, "run", "kart-grid/snn", "--disturb", "noise:0", "--fault", "stuck-max:0")
    assert plain["rows"] == calm["rows"]
    assert calm["disturbances"] == []


def test_run_names_disturbances_and_counts_what_faults_hit(command):
    words = ("run", "kart-grid/snn", "--disturb", "lidar-noise:2", "--disturb", "delay=1",
             "--fault", "dead-neurons:2", "--fault", "lost-spikes=0.1")  # fmt: skip
    document = told(command, *words)
    assert document == told(command, *words) | {"created": document["created"]}
    assert [(d["text"], d["number"]) for d in document["disturbances"]] == [
        ("lidar-noise:2", 50.0), ("delay=1", 1.0),
    ]  # fmt: skip
    dead, lost = document["rows"][0]["faults"]
    assert (dead["hit"], dead["of"], dead["what"]) == (6, 128, "neurons")
    assert not dead["over_time"]
    assert lost["over_time"]
    assert lost["hit"] / lost["of"] == pytest.approx(0.1, rel=0.2)


def test_another_specimen_is_another_chip(command):
    words = ("run", "kart-grid/snn", "--fault", "stuck-max=0.2")
    assert told(command, *words)["rows"] != told(command, *words, "--specimen", "1")["rows"]


def test_compare_breaks_the_chip_and_neither_float_twin_nor_baselines(command):
    words = ("compare", "kart-grid", "--episodes", "2", "--workers", "1")
    whole = told(command, *words)
    broken = told(command, *words, "--fault", "stuck-max=0.5", "--fault", "spurious-spikes=0.3")
    assert seen(whole) != seen(broken)
    assert seen(whole, chip="float") == seen(broken, chip="float")
    assert seen(whole, "ann", None) == seen(broken, "ann", None)
    faulty = [row for row in broken["rows"] if "faults" in row]
    assert [(row["policy"].split(" · ")[0], row["chip"]) for row in faulty] == [
        ("snn", "loihi1"), ("sparse", "loihi1"), ("sparse-gated", "loihi1"),
    ]  # fmt: skip
    assert not any("faults" in row for row in whole["rows"])


def test_a_report_says_so_too(command, tmp_path):
    words = ("compare", "kart-grid", "kart-grid/snn", "--episodes", "1", "--workers", "1")
    told(command, *words, "--disturb", "noise:1", "--fault", "state-flips:3", "-o", tmp_path)
    for name in ("report.md", "report.html"):
        text = (tmp_path / name).read_text(encoding="utf-8")
        assert "noise:1 (0.05 [scale of an observation])" in text
        assert "fault state-flips:3 (0.001) hits" in text
