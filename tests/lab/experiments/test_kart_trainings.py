"""Archives of the kart experiment's trainings: what is packed is done wherever it is unpacked."""

import json
import sys
from dataclasses import replace
from zipfile import ZipFile

import pytest

from lab.experiments import kart_trainings as trainings
from lab.experiments.kart import TRACKS, WORLDS, KartDesign
from lab.experiments.kart_trainings import pack, unpack
from lab.experiments.runner import Part
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.files import write_text
from spikedeploy.trainers.run_folder import RunFolder
from tests import toy_race_env


@pytest.fixture(autouse=True)
def _race(monkeypatch):
    toy_race_env.install(monkeypatch, *WORLDS)


def trial_of(folder, recipe="kart-grid-snn", seed=0):
    trials = KartDesign(runs=str(folder)).trainings()
    return next(each for each in trials if (each.recipe, each.seed) == (recipe, seed))


def perform(trial):
    return Part(trial.name, trial.stored, trial).perform()


def leave(trial, steps=300_000):
    """What a training that took `steps` leaves, with weights that are not packed."""
    run = RunFolder.create(trial.folder, trial.config).path
    (run / "checkpoints/last.safetensors").write_bytes(b"weights")
    (run / "checkpoints/last.json").write_text(json.dumps({"env_steps": steps, "finishes": 1}))
    (run / "policy.nir").write_bytes(b"a policy")
    trial.stored()[0].write({"parameters": 5, "rows": []})


def test_what_was_packed_is_done_where_it_is_unpacked(tmp_path):
    here, there, archives = (tmp_path / name for name in ("here", "there", "archives"))
    leave(trial_of(here))
    leave(trial_of(here, seed=1), steps=10)  # not trained to its end
    (script, *_) = KartDesign(runs=str(here)).scripts()
    script.stored()[0].write({})
    write_text(here / "kart-notes.json", "of somebody else")
    assert [path.name for path in pack(here, archives)] == ["scripts.zip", "kart-grid-snn.zip"]
    made = {path: path.read_bytes() for path in archives.iterdir()}
    assert unpack(archives / "scripts.zip", there) == 1
    assert unpack(archives / "kart-grid-snn.zip", there) == 5
    assert trial_of(there).evaluation == trial_of(here).evaluation
    assert trial_of(there).run.name == trial_of(here).run.name
    assert not (trial_of(there).run / "checkpoints/last.safetensors").exists()
    assert trial_of(there, seed=1).run is None
    pack(there, archives)
    assert {path: path.read_bytes() for path in archives.iterdir()} == made


@pytest.mark.parametrize(
    "asked", [{"episodes": 7}, {"overrides": ("steps=310000",)}], ids=["episodes", "steps"]
)
def test_what_was_unpacked_is_not_trained_or_evaluated_anew_in_its_place(asked, tmp_path):
    leave(trial_of(tmp_path / "here"))
    (archive,) = pack(tmp_path / "here", tmp_path)
    unpack(archive, tmp_path / "there")
    trial = replace(trial_of(tmp_path / "there"), **asked)
    before = {path: path.read_bytes() for path in trial.run.rglob("*") if path.is_file()}
    with pytest.raises(ConfigError, match=r"last\.safetensors is missing, .*, or train again"):
        perform(trial)
    assert {path: path.read_bytes() for path in trial.run.rglob("*") if path.is_file()} == before


@pytest.mark.parametrize("name", ["evaluation.json", "checkpoints/last.json"])
@pytest.mark.parametrize("content", [b"", b"{", b"[]", b"\xff", b"[" * 100_000])
def test_damaged_records_of_a_training_are_named(name, content, tmp_path):
    trial = trial_of(tmp_path)
    leave(trial)
    (trial.run / name).write_bytes(content)
    with pytest.raises(ConfigError, match=rf"{name} is damaged.*: put it back, or move it away"):
        _ = trial.evaluation


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"rows": 3}, r"it\.rows must be a list, found 3\."),
        ({"rows": [{}, "x"]}, r'it\.rows\[1\] must be an object, found "x"\.'),
        ({"parameters": None}, r"it\.parameters must be an integer, found null\."),
    ],
)
def test_an_evaluation_of_another_form_is_named(changes, said, tmp_path):
    trial = trial_of(tmp_path)
    leave(trial)
    file = trial.run / "evaluation.json"
    file.write_text(json.dumps({**json.loads(file.read_text()), **changes}))
    with pytest.raises(ConfigError, match=rf"evaluation\.json is damaged: {said} Put it back"):
        _ = trial.evaluation


@pytest.mark.parametrize(
    ("row", "said"),
    [
        ([], r"row must be an object, found \[\]"),
        ({}, r"row\.[\w-]+ must be a list, found null"),
        ({track: [0, "1"] for track in TRACKS}, r'row\.[\w-]+\[1\] must be an integer, found "1"'),
    ],
)
def test_tracks_of_another_form_are_named(row, said, tmp_path):
    trial = trial_of(tmp_path)
    leave(trial)
    (stored,) = trial.tracks(3)
    stored.write(row)
    with pytest.raises(ConfigError, match=rf"tracks\.json is damaged: {said}\. Put it back"):
        _ = stored.found


def test_a_training_that_ended_is_not_deleted_where_its_counters_are_gone(tmp_path):
    trial = trial_of(tmp_path)
    leave(trial)
    for name in ("last.json", "last.safetensors"):
        (trial.run / "checkpoints" / name).unlink()
    with pytest.raises(ConfigError, match=r"last\.json is missing, and evaluation\.json is there"):
        perform(trial)
    assert (trial.run / "policy.nir").is_file()


def test_a_table_that_was_cut_is_not_one_of_few_finishes(tmp_path):
    trial = trial_of(tmp_path)
    leave(trial)
    (trial.run / "episodes.csv").write_text("env_steps,finish\n")
    with pytest.raises(ConfigError, match=r"episodes\.csv is damaged: it has 0 finishes of 1\."):
        _ = trial.finishes


@pytest.mark.parametrize("take", [lambda t: t.finishes, lambda t: t.steps_to_greedy(0.95)])
def test_a_training_that_ended_and_lost_its_tables_did_not_fail_to_finish(take, tmp_path):
    trial = trial_of(tmp_path)
    leave(trial)
    with pytest.raises(ConfigError, match=r"\.csv is missing: put it back, or train again"):
        take(trial)


def test_what_an_archive_holds_is_not_lost(tmp_path):
    leave(trial_of(tmp_path / "all"))
    leave(trial_of(tmp_path / "all", seed=1))
    leave(trial_of(tmp_path / "some"))
    (archive,) = pack(tmp_path / "all", tmp_path / "zips")
    made = archive.read_bytes()
    with pytest.raises(ValueError, match="which --runs lacks: unpack it there first"):
        pack(tmp_path / "some", tmp_path / "zips")
    assert archive.read_bytes() == made
    kept = trial_of(tmp_path / "some").run / "policy.nir"
    kept.write_bytes(b"a policy")
    assert unpack(archive, tmp_path / "some") == 5  # nothing is written over
    leave(trial_of(tmp_path / "some", seed=2))
    pack(tmp_path / "some", tmp_path / "zips")
    assert len(ZipFile(archive).namelist()) == 15


@pytest.mark.parametrize("name", ["../x.json", "/tmp/x.json", "kart-a/run.sh", "kart-a/../x.json"])
def test_files_of_others_are_refused(name, tmp_path):
    with ZipFile(tmp_path / "a.zip", "w") as zipped:
        zipped.writestr("kart-grid-ann-s0-20260101-000000/config.json", "{}")
        zipped.writestr(name, "x")
    with pytest.raises(ValueError, match=r"a\.zip is damaged: .* is no file of a training"):
        unpack(tmp_path / "a.zip", tmp_path / "runs")
    assert not (tmp_path / "runs").exists()


def test_damaged_archives_leave_nothing(tmp_path):
    leave(trial_of(tmp_path / "here"))
    (archive,) = pack(tmp_path / "here", tmp_path)
    data = bytearray(archive.read_bytes())
    data[-500] ^= 255
    archive.write_bytes(data)
    with pytest.raises(ValueError, match="zip is damaged"):
        unpack(archive, tmp_path / "there")
    assert not (tmp_path / "there").exists()


@pytest.mark.parametrize("what", ["pack", "unpack"])
def test_where_there_is_nothing_that_is_said(what, tmp_path, monkeypatch):
    words = [what, "--runs", str(tmp_path / "runs"), "--archives", str(tmp_path / "zips")]
    monkeypatch.setattr(sys, "argv", ["kart_trainings.py", *words])
    with pytest.raises(SystemExit, match=r"error: .* has no "):
        trainings.main()
