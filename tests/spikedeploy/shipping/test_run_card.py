"""The card of a run: what the hub reads of it, what people read, and who may replace it."""

import json
from pathlib import Path

import pytest

from spikedeploy.reports.runs import LivePage
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.shipping.run_card import export_card, write_run_files
from spikedeploy.trainers.config import MlpConfig, PopsanConfig
from tests import toy_stroll_env

SPIKING = PopsanConfig(hidden=(6,), populations=3)


@pytest.fixture(autouse=True)
def _stroll(monkeypatch):
    toy_stroll_env.install(monkeypatch)


@pytest.fixture
def run(tmp_path):
    return toy_stroll_env.run_folder(tmp_path / "runs", SPIKING)


def head(card):
    """The YAML of a card, whose values are JSON or words."""
    _, lines, _ = card.split("---\n", 2)
    fields = dict(line.split(": ", 1) for line in lines.splitlines())
    return {k: json.loads(v) if v[0] in "[{" else v for k, v in fields.items()}


def test_a_card_has_what_the_hub_and_people_read(run):
    card = write_run_files(run)[-1].read_text()
    found = head(card)
    assert found["library_name"] == "spikedeploy"
    assert {"reinforcement-learning", "nir", toy_stroll_env.ID} <= set(found["tags"])
    (model,) = found["model-index"]
    (metric,) = model["results"][0]["metrics"]
    assert (metric["type"], metric["value"]) == ("mean_reward", 3.0)
    assert "`spikedeploy train smoke --seed 0" in card
    assert "- checkpoint best, after 5 environment steps" in card
    assert "![Return, success, spike rate and operations over the training](curve.svg)" in card
    for title in ("Environment", "Training", "Results", "How to use it", "Limits"):
        assert f"\n## {title}\n" in card
    drawn = (run / "curve.svg").read_text()  # in the colours of its reader
    assert (drawn.startswith("<svg"), "prefers-color-scheme: dark" in drawn) == (True, True)


def test_a_card_that_a_person_took_over_is_kept(run):
    write_run_files(run)
    (run / "card.md").write_text("mine")
    assert [path.name for path in write_run_files(run)] == ["report.html", "curve.svg"]
    with pytest.raises(ConfigError, match="written by hand"):
        export_card(str(run))
    assert (run / "card.md").read_text() == "mine"
    export_card(str(run), force=True)
    assert (run / "card.md").read_text().startswith("---\n")


def test_a_run_that_is_ready_to_be_uploaded_has_policy_card_curve_page_and_film(run):
    files = export_card(str(run), film=True)
    policy, film, *others = map(Path, files.files)
    assert policy.suffix == ".nir"
    assert film.read_bytes()[4:8] == b"ftyp"
    assert [path.name for path in others] == ["report.html", "curve.svg", "card.md"]
    assert "(replay.mp4)" in (run / "card.md").read_text()
    assert export_card(str(run), film=True) == files


def test_a_float_policy_is_not_said_to_spike(tmp_path):
    run = toy_stroll_env.run_folder(tmp_path / "runs", MlpConfig(hidden=(4,)))
    card = write_run_files(run)[-1].read_text()
    assert "float network" in card
    assert "--to c" not in card
    assert "neuromorphic" not in card


@pytest.mark.parametrize("name", ["report.html", "curve.svg", "card.md"])
def test_nothing_is_written_through_a_link_in_a_run_folder(name, run, tmp_path):
    write_run_files(run)
    foreign = tmp_path / "foreign.txt"
    for exists in (True, False):
        (run / name).unlink()
        foreign.write_text("mine") if exists else foreign.unlink()
        (run / name).symlink_to(foreign)
        with pytest.raises(ConfigError, match=f"{name} is a link, through which nothing is"):
            write_run_files(run)
        assert not exists or foreign.read_text() == "mine"
        assert foreign.exists() == exists


def test_a_page_that_cannot_be_written_does_not_end_the_training(run, tmp_path):
    (run / "report.html").symlink_to(tmp_path / "foreign.txt")
    LivePage()(run)
    assert not (tmp_path / "foreign.txt").exists()


def test_a_card_shows_words_of_records_as_they_are(run):
    versions = json.loads((run / "versions.json").read_text())
    (run / "versions.json").write_text(json.dumps({**versions, "numpy": "2\n---\n<script>"}))
    card = write_run_files(run)[-1].read_text()
    assert "<script>" not in card
    assert r"numpy 2 --- \<script\>" in card
