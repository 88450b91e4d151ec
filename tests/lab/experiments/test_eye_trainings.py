"""Archives of kart-eye's trainings: what is packed is trained wherever it is unpacked."""

import json

import pytest

from lab.experiments.eye_entry import EyeEntryDesign
from lab.experiments.eye_trainings import KEPT, pack, replay_walks
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.trainers.config import amend
from spikedeploy.trainers.run_folder import RunFolder


def training_of(runs, name):
    return next(each for each in EyeEntryDesign(runs=str(runs)).trainings() if each.name == name)


def leave(runs, name, **counters):
    """What a training leaves, with an optimiser that is not packed."""
    training = training_of(runs, name)
    config = training.planned()
    if training.parents:
        parent = {key: str(each.existing_run) for key, each in training.parents.items()}
        config = amend(config, overrides=[f"{k}={json.dumps(v)}" for k, v in parent.items()])
    run = RunFolder.create(runs, config).path
    for file in ("last.safetensors", "ops-1e+06.safetensors", "ops-60000.safetensors"):
        (run / "checkpoints" / file).write_bytes(file.encode())
    (run / "checkpoints" / "last.json").write_text(json.dumps({"finished": True, **counters}))
    return run


def test_what_was_packed_is_trained_where_it_is_unpacked(tmp_path):
    here, there, archives = (tmp_path / name for name in ("here", "there", "archives"))
    leave(here, "walks", pool_sha256=["0"])
    run = leave(here, "cnn-s0")
    leave(here, "cnn-s1", finished=False)
    (here / "evaluations" / "a-cell").mkdir(parents=True)
    (here / "evaluations" / "a-cell" / "speck2f-queue=on.json").write_text("{}")
    packed = pack(here, archives)
    assert [file.name for file in packed] == ["evaluations.zip", "walks.zip", "cnn-s0.zip"]
    assert [KEPT.unpack(file, there) for file in packed] == [1, 5, 5]
    assert training_of(there, "cnn-s0").is_trained
    assert training_of(there, "cnn-s0").run.name == run.name
    assert not (there / run.name / "checkpoints" / "last.safetensors").exists()
    assert not training_of(there, "cnn-s1").is_trained
    assert training_of(there, "linear-traces-8x16-s0").run is None  # the walks have its recipe


def test_walks_that_are_not_those_of_the_record_are_not_taken(tmp_path, monkeypatch):
    run = leave(tmp_path, "walks", pool_sha256=["0"])

    def complete(training):
        made = leave(training.folder, training.name)
        (made / "pool").mkdir()
        (made / "pool" / "000.safetensors").write_bytes(b"other walks")
        return True

    monkeypatch.setattr("lab.experiments.training.TrainingJob.complete", complete)
    with pytest.raises(ConfigError, match="the walks are not those"):
        replay_walks(tmp_path)
    assert not (run / "pool").exists()
