"""Archives of the kart experiment's trainings: what is packed is done wherever it is unpacked."""

import json
from zipfile import BadZipFile, ZipFile

import pytest

from benchmarks import kart_trainings
from benchmarks.kart_trainings import pack, unpack
from spikedeploy.experiments.kart.design import WORLDS, ExperimentDesign
from spikedeploy.files import write_text
from spikedeploy.trainers.run_folder import RunFolder
from tests import toy_race_env


@pytest.fixture(autouse=True)
def _race(monkeypatch):
    toy_race_env.install(monkeypatch, *WORLDS)


def trial_of(folder, recipe="kart-grid-snn", seed=0):
    trials = ExperimentDesign(folder=str(folder)).trials()
    return next(each for each in trials if (each.recipe, each.seed) == (recipe, seed))


def leave(trial, steps=300_000):
    """What a training that took `steps` leaves, with weights that are not packed."""
    run = RunFolder.create(trial.folder, trial.config).path
    (run / "checkpoints/last.safetensors").write_bytes(b"weights")
    (run / "checkpoints/last.json").write_text(json.dumps({"env_steps": steps, "finishes": 1}))
    (run / "policy.nir").write_bytes(b"a policy")
    found = {"of": trial.evaluated_with, "parameters": 5, "rows": []}
    write_text(run / "evaluation.json", json.dumps(found))


def test_what_was_packed_is_done_where_it_is_unpacked(tmp_path):
    here, there, archives = (tmp_path / name for name in ("here", "there", "archives"))
    leave(trial_of(here))
    leave(trial_of(here, seed=1), steps=10)  # not trained to its end
    write_text(here / "kart-grid-gap.json", "{}")
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


def test_nothing_is_written_over(tmp_path):
    leave(trial_of(tmp_path))
    archive = next(path for path in pack(tmp_path, tmp_path / "zips") if "snn" in path.name)
    file = trial_of(tmp_path).run / "policy.nir"
    file.write_bytes(b"another")
    assert unpack(archive, tmp_path) == 0
    assert file.read_bytes() == b"another"


@pytest.mark.parametrize("name", ["../x.json", "/tmp/x.json", "kart-a/run.sh", "kart-a/../x.json"])
def test_files_of_others_are_refused(name, tmp_path):
    with ZipFile(tmp_path / "a.zip", "w") as zipped:
        zipped.writestr("kart-grid-ann-s0-20260101-000000/config.json", "{}")
        zipped.writestr(name, "x")
    with pytest.raises(BadZipFile, match="is no file of a training"):
        unpack(tmp_path / "a.zip", tmp_path / "runs")
    assert not (tmp_path / "runs").exists()


def test_archives_that_unpack_to_gigabytes_are_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(kart_trainings, "_MOST", 10)
    with ZipFile(tmp_path / "a.zip", "w") as zipped:
        zipped.writestr("kart-grid-gap.json", "x" * 11)
    with pytest.raises(BadZipFile, match="is no file of a training"):
        unpack(tmp_path / "a.zip", tmp_path / "runs")
