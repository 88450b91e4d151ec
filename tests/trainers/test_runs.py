"""What a run leaves, and what is damaged in it: a sentence, with what can be saved."""

import errno
import io
import json
import os
import re
import signal
import sys
from types import ModuleType

import numpy as np
import pytest
import safetensors.torch
import torch
from gymnasium.spaces import Box
from rich.console import Console
from safetensors import SafetensorError

from spikedeploy import envs
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.trainers.config import resolve
from spikedeploy.trainers.metrics_file import Journal, read_metrics
from spikedeploy.trainers.policies import MlpPolicy
from spikedeploy.trainers.progress import ProgressBar
from spikedeploy.trainers.run_folder import RunFolder
from spikedeploy.trainers.sac import SacConfig
from spikedeploy.trainers.train import train
from tests.toy_pointing_env import PointingEnv
from tests.trainers.test_resume import SAC, After, resumed

TINY = [
    "steps=400", "warm_up=40", "batch=8", "policy.hidden=[8]", "critic_hidden=[8]",
    "log_every=40", "checkpoint_every=100", "validation.every=80", "validation.limit=5",
]  # fmt: skip


@pytest.fixture(autouse=True)
def curves():
    """Learning curves, drawn as for users."""


@pytest.fixture
def world(monkeypatch):
    """A tiny environment that can send Ctrl-C at a step of its choice."""

    class Interrupting(PointingEnv):
        count = 0
        interrupt_at = -1

        def step(self, action):
            Interrupting.count += 1
            if Interrupting.count == Interrupting.interrupt_at:
                signal.raise_signal(signal.SIGINT)
            return super().step(action)

    monkeypatch.setattr(envs, "make", lambda name, **options: Interrupting())
    return Interrupting


def last(run):
    return json.loads((run / "checkpoints" / "last.json").read_text())


def test_a_run_leaves_all_its_files(tmp_path, world):
    run = train("smoke", overrides=TINY, runs=tmp_path, seed=7, quiet=True)
    assert run.name.startswith("smoke-s7-")
    found = {str(path.relative_to(run)) for path in run.rglob("*") if path.is_file()}
    expected = {"config.json", "versions.json", "metrics.csv", "curve.png"}
    expected |= {f"checkpoints/{name}" for name in (
        "last.json", "last.safetensors", "best.json", "best.safetensors")}  # fmt: skip
    assert expected <= found
    assert not [name for name in found if name.endswith(".part") or "replay" in name]
    assert json.loads((run / "config.json").read_text())["seed"] == 7
    assert json.loads((run / "versions.json").read_text())["torch"] == torch.__version__


def test_a_finished_run_is_left_as_it_is(tmp_path, world, capsys):
    run = train("smoke", overrides=TINY, runs=tmp_path, quiet=True)
    before = (run / "checkpoints" / "last.safetensors").read_bytes()
    train("smoke", resume=run, runs=tmp_path, quiet=True)
    assert (run / "checkpoints" / "last.safetensors").read_bytes() == before
    settings = (run / "config.json").read_bytes()
    train("smoke", resume=run, overrides=["steps=300"], runs=tmp_path, quiet=True)
    assert "was trained, and keeps its configuration" in capsys.readouterr().err
    with pytest.raises(ConfigError, match="has no replay"):
        train("smoke", resume=run, overrides=["steps=800"], runs=tmp_path, quiet=True)
    assert (run / "config.json").read_bytes() == settings


@pytest.mark.parametrize(
    ("recipe", "named", "message"),
    [
        (None, {}, "name a recipe to train, or a run to resume"),
        ("ppo-snn", {}, "trains in any environment: name one"),
        ("smoke", {"env": "kart-grid"}, "smoke is made for hexapod, not for kart-grid"),
        ("smoke-popsan", {"resume": "last"}, "is a run of 'smoke', not of 'smoke-popsan'"),
    ],
)
def test_a_training_that_cannot_be_meant_is_refused(recipe, named, message, tmp_path):
    if "resume" in named:
        named = {"resume": RunFolder.create(tmp_path, resolve(SacConfig, "smoke")).path}
    with pytest.raises(ConfigError, match=message):
        train(recipe, runs=tmp_path, quiet=True, **named)


def test_the_policy_of_a_run_is_of_best_and_else_last(tmp_path):
    run = RunFolder.create(tmp_path, resolve(SacConfig, "smoke"))
    last_policy, best_policy = MlpPolicy(2, 1, (3,)), MlpPolicy(2, 1, (3,))
    observation = torch.randn(4, 2)
    run.save("last", last_policy, {})
    assert torch.equal(run.policy()(observation), last_policy(observation))
    run.save("best", best_policy, {})
    assert torch.equal(run.policy()(observation), best_policy(observation))
    assert torch.equal(run.policy("last")(observation), last_policy(observation))


def test_the_last_run_is_the_newest_with_a_checkpoint(tmp_path):
    config = resolve(SacConfig, "smoke")
    older, newer = RunFolder.create(tmp_path, config), RunFolder.create(tmp_path, config)
    with pytest.raises(ConfigError, match="2 without a checkpoint"):
        RunFolder.find("last", tmp_path)
    older.save("last", MlpPolicy(2, 1, (3,)), {})
    assert RunFolder.find("last", tmp_path).path == older.path
    newer.save("best", MlpPolicy(2, 1, (3,)), {})
    assert RunFolder.find("last", tmp_path).path == newer.path


def test_a_start_that_is_interrupted_leaves_no_run_folder(tmp_path, world, monkeypatch):
    from spikedeploy.trainers.sac import Sac

    def interrupted(self):
        signal.raise_signal(signal.SIGINT)
        signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(Sac, "begin", interrupted)
    with pytest.raises(KeyboardInterrupt):
        train("smoke", overrides=TINY, runs=tmp_path, quiet=True)
    assert list(tmp_path.iterdir()) == []


def bar_of(width, **row):
    """What a terminal of this width shows of a run at 12 %."""
    screen = Console(file=io.StringIO(), force_terminal=True, width=width, color_system=None)
    with ProgressBar("hexapod-sparse-s0-20260101-000000", console=screen) as bar:
        bar.show(row)
        bar.move_to(120_000, 1_000_000)
    return [
        re.sub(r"\x1b\[[^a-zA-Z]*[a-zA-Z]|\r", "", line)
        for line in screen.file.getvalue().split("\n")
    ]


@pytest.mark.parametrize("width", [50, 80, 160])
def test_the_progress_bar_fits_the_terminal(width):
    row = {"episode_return": 3000.0, "eval_return": 3100.0, "best": 3200.0, "updates_per_s": 17.0,
           "phase": 2.0, "walks": 340.0, "operations": 1234.0, "loss": 0.5}  # fmt: skip
    lines = bar_of(width, **row)
    assert lines[0] == "hexapod-sparse-s0-20260101-000000"
    assert all(len(line) <= width for line in lines)
    assert any("120,000 / 1,000,000" in line and "12 %" in line for line in lines)
    assert any(line.startswith("return 3,000  validation 3,100") for line in lines)
    if width == 160:
        assert any(line.endswith("phase 2  340 walks  about 1,234 operations") for line in lines)


def test_without_a_terminal_progress_comes_in_lines(capsys, monkeypatch):
    monkeypatch.setattr("spikedeploy.trainers.progress.PAUSE", 0.0)
    with ProgressBar("run") as bar:
        bar.show({"episode_return": 12.0})
        bar.move_to(5, 20)
        bar.move_to(10, 20)
        bar.move_to(24, 20)  # environments that step together end beyond it
    lines = [re.sub(r"  \S+ left", "", line) for line in capsys.readouterr().err.splitlines()]
    assert lines == [
        "run", "5 / 20  25 %  return 12", "10 / 20  50 %  return 12", "20 / 20  100 %  return 12"
    ]  # fmt: skip


def test_the_speed_is_of_the_last_half_minute_not_of_the_last_row(capsys, monkeypatch):
    monkeypatch.setattr("spikedeploy.trainers.progress.PAUSE", 0.0)
    clock = [0.0]
    screen = Console(file=io.StringIO(), get_time=lambda: clock[0])
    with ProgressBar("run", console=screen) as bar:
        bar.show({"steps_per_s": 500.0})
        for second in range(0, 101, 10):
            clock[0] = float(second)
            bar.move_to(second * 7, 10_000)
    lines = capsys.readouterr().err.splitlines()
    assert lines[0].endswith("500 steps/s")  # nothing else is known yet
    assert lines[-1].endswith("  7 steps/s")
    assert "left" not in lines[0]
    assert lines[-1].startswith("700 / 10,000  7 %  0:22:09 left  ")  # 9,300 at 7 a second


def test_a_path_that_is_no_run_is_named(tmp_path):
    with pytest.raises(ConfigError, match=r"no config\.json"):
        RunFolder.find("nothing", tmp_path)
    with pytest.raises(ConfigError, match=r"no config\.json in it$"):
        RunFolder.find(tmp_path / "nothing", "elsewhere")  # an absolute path lies in no folder
    with pytest.raises(ConfigError, match="no run of recipe smoke"):
        RunFolder.find("last", tmp_path, "smoke")
    with pytest.raises(ConfigError, match="no checkpoint 'best'"):
        RunFolder.create(tmp_path, resolve(SacConfig, "smoke")).policy("best")


def test_two_runs_of_the_same_second_have_different_folders(tmp_path):
    config = resolve(SacConfig, "smoke")
    assert len({RunFolder.create(tmp_path, config).path for _ in range(3)}) == 3


@pytest.mark.parametrize(("row", "seen"), [
    ({"eval_finish": 0.95, "eval_success": 0.9}, "success 90%"),
    ({"eval_finish": 0.95}, "success 95%"),
    ({"sparsity_lif1": 0.9, "sparsity_lif2": 0.8}, "spikes 15.0%"),
])  # fmt: skip
def test_people_and_tensorboard_see_success_and_spike_rate(
    tmp_path, monkeypatch, capsys, row, seen
):
    monkeypatch.setattr("spikedeploy.trainers.progress.PAUSE", 0.0)
    with ProgressBar("") as bar:
        journal = Journal(RunFolder.create(tmp_path, resolve(SacConfig, "smoke")), ("step",), bar)
        points = []
        monkeypatch.setattr(journal.board, "add", lambda step, row: points.append((step, row)))
        journal.add({"step": 5, **row})
        bar.move_to(5, 10)
        journal.close()
    assert capsys.readouterr().err.strip().endswith(seen)
    ((step, scalars),) = points
    assert (step, len(scalars)) == (5, 2)
    assert read_metrics(journal._run.metrics) == [{"step": 5.0}]


def test_tensorboard_gets_the_columns_of_a_row_at_its_step(tmp_path, monkeypatch):
    points, folders = [], []

    class Writer:
        def __init__(self, folder, purge_step=None):
            folders.append((folder, purge_step))

        def add_scalar(self, name, value, step):
            points.append((name, value, step))

        def close(self):
            pass

    board = ModuleType("torch.utils.tensorboard")
    board.SummaryWriter = Writer
    monkeypatch.setitem(sys.modules, "torch.utils.tensorboard", board)
    monkeypatch.setattr("spikedeploy.trainers.metrics_file.find_spec", lambda name: True)
    run = RunFolder.create(tmp_path, resolve(SacConfig, "smoke"))
    with ProgressBar("", quiet=True) as bar:
        journal = Journal(run, ("step", "eval_finish"), bar)
        journal.add({"step": 5, "eval_finish": 0.5, "of_no_column": 1.0})
        journal.rewind(5, None)
        journal.close()
    assert points == [("step", 5, 5), ("eval_finish", 0.5, 5), ("eval_success", 0.5, 5)]
    assert folders == [(str(run.path), None), (str(run.path), 6)]


def test_a_training_that_is_refused_leaves_no_run_folder(tmp_path, world):
    whole = train("smoke", overrides=TINY, runs=tmp_path, quiet=True)
    for recipe, overrides in (
        ("smoke-distill", ["teacher=nowhere"]),
        ("smoke-sparse", ["teacher=nowhere"]),
        ("smoke-sparse-tuned", ["start=nowhere"]),
    ):
        with pytest.raises(ConfigError, match="nowhere"):
            train(recipe, overrides=overrides, runs=tmp_path, quiet=True)
        assert list(tmp_path.iterdir()) == [whole]


@pytest.mark.parametrize("change", ["policy.hidden=[7]", "env.options.width=7"])
def test_a_resumed_run_keeps_its_network_and_settings(change, interrupted, monkeypatch):
    class Wider(PointingEnv):
        observation_space = Box(-1.0, 1.0, (7,), np.float64)

        def _draw(self):
            return np.zeros(7)

    if "width" in change:
        monkeypatch.setattr(envs, "make", lambda name, **options: Wider())
    before = (interrupted / "config.json").read_bytes()
    with pytest.raises(ConfigError, match=r"keeps its network, .* (hidden|observations) is"):
        train("smoke", resume=interrupted, overrides=[change], quiet=True)
    assert (interrupted / "config.json").read_bytes() == before


@pytest.fixture
def interrupted(tmp_path, world):
    """A run that was stopped after 170 of 400 steps; it has rows up to step 160."""
    world.interrupt_at = 170
    return train("smoke", overrides=TINY, runs=tmp_path, quiet=True)


@pytest.mark.parametrize(("damage", "word"), [
    (lambda old: b"env_steps,updates\n1,2,3\n", "no table of numbers"),
    (lambda old: old.split(b"\n", 1)[1], "rows end at|no table"),
    (lambda old: b"\n".join(old.split(b"\n")[:3]) + b"\n", "rows end at 80, and .* to 160"),
])  # fmt: skip
def test_damaged_metrics_are_refused(damage, word, interrupted):
    file, before = interrupted / "metrics.csv", (interrupted / "config.json").read_bytes()
    file.write_bytes(damaged := damage(file.read_bytes()))
    with pytest.raises(ConfigError, match=word):
        train("smoke", resume=interrupted, overrides=["steps=800"], quiet=True)
    assert file.read_bytes() == damaged
    assert (interrupted / "config.json").read_bytes() == before


def test_without_metrics_a_resumed_run_says_that_rows_begin_anew(interrupted, capsys):
    (interrupted / "metrics.csv").unlink()
    train("smoke", resume=interrupted, quiet=True)
    assert "metrics.csv has no rows: they begin at 1" in capsys.readouterr().err


def test_a_picture_of_damaged_metrics_is_refused_by_name(tmp_path):
    path = tmp_path / "metrics.csv"
    for content in (b"\xff\xfe", b"step,loss\n1,much\n", b"step,loss\n1,2,3\n"):
        path.write_bytes(content)
        with pytest.raises(ConfigError, match=r"metrics\.csv is no table of numbers"):
            read_metrics(path)


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
    with pytest.raises(ConfigError, match=rf"{name}\.safetensors is not .*Put the file back"):
        RunFolder(run).policy(name)
    RunFolder(run).policy(other)


def test_a_run_without_its_weights_is_neither_trained_from_the_beginning_nor_changed(run):
    """As an unpacked training is, of which only what others read was kept."""
    for path in (run / "checkpoints").glob("*.safetensors"):
        path.unlink()
    before = {path: path.read_bytes() for path in run.rglob("*") if path.is_file()}
    with pytest.raises(ConfigError, match=r"last\.safetensors is missing"):
        train(None, resume=run, overrides=["steps=303"], quiet=True)
    with pytest.raises(ConfigError, match=r"best\.safetensors is missing.*train again"):
        RunFolder(run).policy("best")
    assert {path: path.read_bytes() for path in run.rglob("*") if path.is_file()} == before


def test_a_configuration_that_was_cut_off_is_refused(run):
    file = run / "config.json"
    file.write_text(changed := file.read_text()[:99])
    with pytest.raises(ConfigError, match=r"config\.json is damaged"):
        resumed(run)
    assert file.read_text() == changed


def test_a_run_of_an_earlier_version_is_refused_by_its_settings(run):
    file = run / "config.json"
    file.write_text(json.dumps({**json.loads(file.read_text()), "ghosts": True}))
    with pytest.raises(ConfigError, match=r"ghosts: .* another version made the run"):
        resumed(run)


def test_a_row_that_a_full_disk_cut_off_after_the_checkpoint_is_dropped(run):
    with (run / "metrics.csv").open("a") as file:
        file.write("177,12")
    resumed(run)
    steps = [row["env_steps"] for row in read_metrics(run / "metrics.csv")]
    assert steps == sorted(set(steps))


def test_what_a_kill_left_of_unfinished_files_is_deleted_and_exports_stay(run):
    ours = run / "checkpoints" / ".last.safetensors.77.part"
    other = run / ".net.nir.77.part"
    for path in (ours, other):
        path.write_bytes(b"half")
    resumed(run)
    assert other.is_file()
    assert not ours.exists()


def test_a_run_that_is_trained_can_be_read_and_not_resumed(run):
    with RunFolder(run).locked():
        with pytest.raises(ConfigError, match=rf"is being trained .*process {os.getpid()} on"):
            resumed(run)
        RunFolder(run).policy()


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
