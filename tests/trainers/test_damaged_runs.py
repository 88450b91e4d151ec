"""What is damaged in a run folder is named in a sentence, with what can be saved."""

import errno
import json
import os
import signal

import pytest
import safetensors.torch
from safetensors import SafetensorError

from spikedeploy import envs
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.trainers.metrics import read
from spikedeploy.trainers.run_folder import RunFolder, load_policy
from spikedeploy.trainers.train import train
from tests.toy_pointing_env import PointingEnv
from tests.trainers.test_resume import KART, SAC, After, resumed


@pytest.fixture
def world(monkeypatch):
    monkeypatch.setattr(envs, "make", lambda name, **options: PointingEnv())


@pytest.fixture
def run(world, tmp_path):
    """A run that was stopped on its way."""
    return train("smoke", overrides=SAC, runs=tmp_path, quiet=True, interrupt=After(43))


def flip(path, part):
    content = bytearray(path.read_bytes())
    content[int(part * len(content))] ^= 4
    path.write_bytes(content)


@pytest.mark.parametrize(("name", "part"), [("last", 0.02), ("last", 0.6), ("best", 0.999)])
def test_a_flipped_bit_of_a_checkpoint_is_found(name, part, run):
    flip(RunFolder(run).checkpoint(name), part)
    other = {"last": "best", "best": "last"}[name]
    with pytest.raises(ConfigError, match=rf"{name}\.safetensors is not .*--checkpoint {other}"):
        load_policy(run, name)
    load_policy(run, other)


def test_a_run_with_a_damaged_checkpoint_is_not_resumed(run):
    flip(RunFolder(run).checkpoint("last"), 0.9)
    with pytest.raises(ConfigError, match=r"its checksum\. Put the file back, or train again"):
        resumed(run)


def test_a_run_without_its_weights_is_neither_trained_from_the_beginning_nor_changed(run):
    """As an unpacked training is, of which only what others read was kept."""
    for path in (run / "checkpoints").glob("*.safetensors"):
        path.unlink()
    before = {path: path.read_bytes() for path in run.rglob("*") if path.is_file()}
    with pytest.raises(ConfigError, match=r"last\.safetensors is missing, .* cannot be resumed"):
        train(None, resume=run, overrides=["steps=303"], quiet=True)
    with pytest.raises(ConfigError, match=r"best\.safetensors is missing, .*train again"):
        load_policy(run, "best")
    assert {path: path.read_bytes() for path in run.rglob("*") if path.is_file()} == before


@pytest.mark.parametrize("damage", ["flip", "half"])
def test_a_damaged_replay_is_named_and_the_policies_are_whole(damage, run):
    replay = RunFolder(run).replay
    if damage == "flip":
        flip(replay, 0.7)
    else:
        replay.write_bytes(replay.read_bytes()[: replay.stat().st_size // 2])
    with pytest.raises(ConfigError, match=r"replay\.safetensors is damaged.*spikedeploy export"):
        resumed(run)
    load_policy(run)


def test_a_configuration_that_was_cut_off_is_refused(run):
    file = run / "config.json"
    file.write_text(changed := file.read_text()[:99])
    with pytest.raises(ConfigError, match=r"cannot read .*config\.json"):
        resumed(run)
    assert file.read_text() == changed


def test_a_setting_that_changes_on_resuming_is_no_damage(run):
    train(None, resume=run, overrides=["steps=303"], quiet=True)
    assert RunFolder(run).settings()["steps"] == 303


def test_files_in_ghosts_that_training_did_not_write_stay(tmp_path):
    run = train("smoke-kart", overrides=KART, runs=tmp_path, quiet=True, interrupt=After(4))
    mine, later = run / "ghosts" / "abc.npz", run / "ghosts" / "00099.npz"
    mine.parent.mkdir(exist_ok=True)
    mine.write_bytes(b"whatever")
    later.write_bytes(b"whatever")
    resumed(run)
    assert mine.read_bytes() == b"whatever"
    assert not later.exists()


@pytest.mark.parametrize("content", [b"\x00" * 90, b"1,2,3\n"])
def test_damaged_episodes_are_named(content, tmp_path):
    run = train("smoke-kart", overrides=KART, runs=tmp_path, quiet=True, interrupt=After(4))
    (run / "episodes.csv").write_bytes(content)
    with pytest.raises(ConfigError, match=r"episodes\.csv is damaged: .*move it away"):
        resumed(run)
    (run / "episodes.csv").unlink()
    resumed(run)


def test_a_row_that_a_full_disk_cut_off_after_the_checkpoint_is_dropped(run):
    with (run / "metrics.csv").open("a") as file:
        file.write("177,12")
    resumed(run)
    steps = [row["env_steps"] for row in read(run / "metrics.csv")]
    assert steps == sorted(set(steps))


def test_what_a_kill_left_of_unfinished_files_is_deleted_and_exports_stay(run):
    ours = [run / ".config.json.77.part", run / "checkpoints" / ".last.safetensors.77.part"]
    (run / "films").mkdir()
    ours.append(run / "films" / ".80.gif.77.part")
    other = run / ".net.nir.77.part"
    for path in (*ours, other):
        path.write_bytes(b"half")
    resumed(run)
    assert other.is_file()
    assert not any(path.exists() for path in ours)


def test_a_run_that_is_trained_can_be_read_and_not_resumed(run):
    with RunFolder(run).locked():
        with pytest.raises(ConfigError, match=rf"is being trained .*process {os.getpid()} on"):
            resumed(run)
        load_policy(run)


full = OSError(errno.ENOSPC, "No space left on device")


@pytest.mark.parametrize(
    "error", [full, SafetensorError("I/O error: No space left on device (os error 28)")]
)
def test_a_full_disk_is_a_sentence_and_the_checkpoint_before_is_whole(
    error, world, tmp_path, monkeypatch
):
    saved, save = [], safetensors.torch.save_file

    def failing(tensors, path, **named):
        save(tensors, path, **named)
        saved.append(path)
        if len(saved) > 4:
            raise error

    with monkeypatch.context() as patch:
        patch.setattr(safetensors.torch, "save_file", failing)
        with pytest.raises(ConfigError, match=r"could not be written: .*No space left on device"):
            train("smoke", overrides=SAC, runs=tmp_path, quiet=True)
    (run,) = tmp_path.iterdir()
    assert not list(run.rglob("*.part"))
    RunFolder(run).load("last")
    resumed(run)
    assert json.loads((run / "checkpoints" / "last.json").read_text())["finished"]


def test_runs_that_cannot_be_made_are_a_sentence(world, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(ConfigError, match=r"cannot make a run folder in .*--runs"):
        train("smoke", overrides=SAC, runs=tmp_path / "file" / "runs", quiet=True)


@pytest.mark.parametrize(("name", "code"), [("SIGINT", 130), ("SIGTERM", 143), ("SIGHUP", 129)])
def test_signals_stop_at_a_checkpoint(name, code, tmp_path, monkeypatch, command):
    class Interrupting(PointingEnv):
        count = 0

        def step(self, action):
            Interrupting.count += 1
            if Interrupting.count == 50:
                signal.raise_signal(getattr(signal, name))
            return super().step(action)

    monkeypatch.setattr(envs, "make", lambda name, **options: Interrupting())
    changes = [word for setting in SAC for word in ("--set", setting)]
    found, _, err = command("train", "smoke", "--runs", tmp_path, *changes)
    assert found == code
    assert "go on with `spikedeploy train --resume last" in err
    (run,) = tmp_path.iterdir()
    assert 0 < json.loads((run / "checkpoints" / "last.json").read_text())["env_steps"] < 300


def test_a_hangup_that_nohup_ignores_stays_ignored(world, tmp_path):
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with After(0):
            assert signal.getsignal(signal.SIGHUP) == signal.SIG_IGN
    finally:
        signal.signal(signal.SIGHUP, before)
