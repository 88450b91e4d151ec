import io
import json
import re
import signal

import pytest
import torch
from rich.console import Console
from safetensors.torch import load_file

from spikedeploy import envs
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.trainers.config import resolve
from spikedeploy.trainers.metrics import Metrics, read
from spikedeploy.trainers.policies import MlpPolicy
from spikedeploy.trainers.progress import Journal, ProgressBar
from spikedeploy.trainers.run_folder import RunFolder, load_policy
from spikedeploy.trainers.sac.learner import SacConfig
from spikedeploy.trainers.train import train
from tests.toy_pointing_env import PointingEnv

TINY = [
    "steps=400", "warm_up=40", "batch=8", "policy.hidden=[8]", "critic_hidden=[8]",
    "log_every=40", "checkpoint_every=100", "validation.every=80", "validation.limit=5",
]  # fmt: skip


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


def test_interrupted_training_leaves_a_checkpoint_and_resumes(tmp_path, world):
    world.interrupt_at = 170
    run = train("smoke", overrides=TINY, runs=tmp_path, quiet=True)
    state = last(run)
    assert 100 < state["env_steps"] < 400
    assert not state["finished"]
    assert (run / "replay.safetensors").is_file()

    assert train("smoke", resume="last", runs=tmp_path, quiet=True) == run
    done = last(run)
    assert done["finished"]
    assert (done["env_steps"], done["updates"]) == (400, 90)
    steps = [row["env_steps"] for row in read(run / "metrics.csv")]
    assert steps == sorted(set(steps))
    assert steps[-1] == 400


def test_a_resumed_run_continues_from_its_weights_and_moments(tmp_path, world):
    world.interrupt_at = 170
    run = RunFolder(train("smoke", overrides=TINY, runs=tmp_path, quiet=True))
    before = run.load("last")[1]
    state = last(run.path)
    # nothing is left to do, so that what is written again is what was read
    again = [f"steps={state['env_steps'] + 2}", "update_every=1000000"]
    train("smoke", resume=run.path, overrides=again, runs=tmp_path, quiet=True)
    after = run.load("last")[1]
    assert last(run.path)["updates"] == state["updates"]
    for name in before:
        if "adam" in name or name.startswith(("critic", "target", "policy.layers")):
            assert torch.equal(before[name], after[name]), name
    assert any(name.startswith("critic_adam.0.exp_avg") for name in before)


def test_a_finished_run_is_left_as_it_is(tmp_path, world):
    run = train("smoke", overrides=TINY, runs=tmp_path, quiet=True)
    before = (run / "checkpoints" / "last.safetensors").read_bytes()
    train("smoke", resume=run, runs=tmp_path, quiet=True)
    assert (run / "checkpoints" / "last.safetensors").read_bytes() == before
    with pytest.raises(ConfigError, match=r"replay.*missing"):
        train("smoke", resume=run, overrides=["steps=800"], runs=tmp_path, quiet=True)


def test_a_run_of_another_recipe_is_not_resumed(tmp_path, world):
    run = train("smoke", overrides=TINY, runs=tmp_path, quiet=True)
    with pytest.raises(ConfigError, match="is a run of 'smoke', not of 'smoke-popsan'"):
        train("smoke-popsan", resume=run, runs=tmp_path, quiet=True)


def test_best_is_the_best_of_the_validations(tmp_path, world):
    run = train("smoke", overrides=TINY, runs=tmp_path, quiet=True)
    returns = [row["eval_return"] for row in read(run / "metrics.csv") if "eval_return" in row]
    best = json.loads((run / "checkpoints" / "best.json").read_text())
    assert best["eval_return"] == pytest.approx(max(returns))
    assert best["policy"]["kind"] == "mlp"


def test_equal_seeds_give_equal_weights(tmp_path, world):
    first, second, other = (
        load_file(train("smoke", overrides=TINY, seed=seed, runs=tmp_path, quiet=True)
                  / "checkpoints" / "last.safetensors")
        for seed in (1, 1, 2)
    )  # fmt: skip
    assert all(torch.equal(first[name], second[name]) for name in first)
    assert not torch.equal(first["policy.layers.0.weight"], other["policy.layers.0.weight"])


def test_load_policy_takes_best_and_else_last(tmp_path):
    run = RunFolder.create(tmp_path, resolve(SacConfig, "smoke"))
    last_policy, best_policy = MlpPolicy(2, 1, (3,)), MlpPolicy(2, 1, (3,))
    observation = torch.randn(4, 2)
    run.save("last", last_policy, {})
    assert torch.equal(load_policy(run.path)(observation), last_policy(observation))
    run.save("best", best_policy, {})
    assert torch.equal(load_policy(run.path)(observation), best_policy(observation))
    assert torch.equal(load_policy(run.path, "last")(observation), last_policy(observation))


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
    from spikedeploy.trainers.sac.sac import Sac

    def interrupted(self, stopped):
        signal.raise_signal(signal.SIGINT)
        signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(Sac, "_iterate", interrupted)
    with pytest.raises(KeyboardInterrupt):
        train("smoke", overrides=TINY, runs=tmp_path, quiet=True)
    assert list(tmp_path.iterdir()) == []


def test_ctrl_c_is_acknowledged_and_says_how_to_go_on(tmp_path, world, command, monkeypatch):
    monkeypatch.chdir(tmp_path)
    world.interrupt_at = 170
    changes = [word for setting in TINY for word in ("--set", setting)]
    code, out, err = command("train", "smoke", *changes)
    assert (code, out) == (130, "")
    first, acknowledged, last_line = err.splitlines()
    assert first.startswith("smoke-s0-")
    assert acknowledged.startswith("stopping after this step …")
    assert last_line == "stopped at 40 %; go on with `spikedeploy train --resume last`"
    code, out, err = command("train", "--resume", "last")
    assert (code, out.splitlines()[0]) == (0, f"trained: runs/{first}")


def bar_of(width, **row):
    """What a terminal of this width shows of a run at 12 %."""
    screen = Console(file=io.StringIO(), force_terminal=True, width=width, color_system=None)
    with ProgressBar("hexapod-sparse-s0-20260101-000000", console=screen) as bar:
        bar.show(row)
        bar.at(120_000, 1_000_000)
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
        assert any(line.endswith("phase 2  340 walks  1,234 operations") for line in lines)


def test_without_a_terminal_progress_comes_in_lines(capsys, monkeypatch):
    monkeypatch.setattr("spikedeploy.trainers.progress.PAUSE", 0.0)
    with ProgressBar("run") as bar:
        bar.show({"episode_return": 12.0})
        bar.at(5, 20)
        bar.at(10, 20)
    lines = [re.sub(r"  \S+ left", "", line) for line in capsys.readouterr().err.splitlines()]
    assert lines == [
        "run", "5 / 20  25 %  return 12", "10 / 20  50 %  return 12"
    ]  # fmt: skip


def test_the_speed_is_of_the_last_half_minute_not_of_the_last_row(capsys, monkeypatch):
    monkeypatch.setattr("spikedeploy.trainers.progress.PAUSE", 0.0)
    clock = [0.0]
    screen = Console(file=io.StringIO(), get_time=lambda: clock[0])
    with ProgressBar("run", console=screen) as bar:
        bar.show({"steps_per_s": 500.0})
        for second in range(0, 101, 10):
            clock[0] = float(second)
            bar.at(second * 7, 10_000)
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


def test_a_broken_checkpoint_is_named(tmp_path):
    run = RunFolder.create(tmp_path, resolve(SacConfig, "smoke"))
    run.save("last", MlpPolicy(2, 1, (3,)), {})
    path = run.checkpoint("last")
    path.write_bytes(path.read_bytes()[:50])
    with pytest.raises(ConfigError, match=r"last\.safetensors is not a valid checkpoint"):
        run.load("last")


def test_two_runs_of_the_same_second_have_different_folders(tmp_path):
    config = resolve(SacConfig, "smoke")
    assert len({RunFolder.create(tmp_path, config).path for _ in range(3)}) == 3


def test_metrics_after_the_checkpoint_are_dropped(tmp_path):
    metrics = Metrics(tmp_path / "metrics.csv", ("step", "loss"))
    metrics.begin()
    for step in (1, 2, 3):
        metrics.add({"step": step} | ({"loss": 0.5} if step == 2 else {}))
    metrics.rewind(2)
    assert read(metrics.path) == [{"step": 1.0}, {"step": 2.0, "loss": 0.5}]


def test_a_journal_drops_values_without_a_column(tmp_path):
    run = RunFolder.create(tmp_path, resolve(SacConfig, "smoke"))
    journal = Journal(run, ("env_steps", "loss"), ProgressBar("", quiet=True))
    journal.add({"env_steps": 1, "loss": 0.5, "eval_finish": 1.0})
    journal.close()
    assert read(run.metrics) == [{"env_steps": 1.0, "loss": 0.5}]


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
        bar.at(5, 10)
        journal.close()
    assert capsys.readouterr().err.strip().endswith(seen)
    ((step, scalars),) = points
    assert (step, len(scalars)) == (5, 2)
    assert read(journal.metrics.path) == [{"step": 5.0}]


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


def test_a_training_that_fails_later_keeps_what_it_learned(tmp_path, world, monkeypatch):
    from spikedeploy.trainers.sac.sac import Sac

    iterate = Sac._iterate

    def failing(self, stopped):
        if self.step > 150:
            raise ConfigError("no more")
        return iterate(self, stopped)

    monkeypatch.setattr(Sac, "_iterate", failing)
    with pytest.raises(ConfigError, match="no more"):
        train("smoke", overrides=TINY, runs=tmp_path, quiet=True)
    (run,) = tmp_path.iterdir()
    assert RunFolder(run).checkpoint("last").is_file()


def test_a_resumed_run_that_is_refused_keeps_its_configuration(tmp_path, world):
    run = train("smoke", overrides=TINY, runs=tmp_path, quiet=True)
    before = (run / "config.json").read_bytes()
    (run / "metrics.csv").write_bytes(b"\x89\xff")
    with pytest.raises(ConfigError, match="is damaged"):
        train("smoke", resume=run, overrides=["steps=800"], runs=tmp_path, quiet=True)
    assert (run / "config.json").read_bytes() == before


@pytest.fixture
def interrupted(tmp_path, world):
    """A run that was stopped after 170 of 400 steps; it has rows up to step 160."""
    world.interrupt_at = 170
    return train("smoke", overrides=TINY, runs=tmp_path, quiet=True)


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda old: b"\x89\xfe\x00" * 50, "no table of numbers"),
        (lambda old: b"", "no table of numbers"),
        (lambda old: old.split(b"\n", 1)[1], "its first line is not the names of columns"),
        (lambda old: old[:-9], "its rows end at 120, and .* to 160"),
        (lambda old: old.replace(b",,", b",", 1), "is cut off"),
        (lambda old: b"\n".join(old.split(b"\n")[:3]) + b"\n", "its rows end at 80, and .* to 160"),
        (
            lambda old: old.replace(b"env_steps,", b"env_steps,odd_", 1),
            "names of columns, it has 'odd_",
        ),
    ],
)
def test_damaged_metrics_are_refused_with_what_can_be_done(damage, message, interrupted):
    file = interrupted / "metrics.csv"
    file.write_bytes(damaged := damage(file.read_bytes()))
    with pytest.raises(ConfigError, match=rf"metrics\.csv is damaged: .*{message}") as error:
        train("smoke", resume=interrupted, quiet=True)
    assert "move it away: then a new one begins at 1" in str(error.value)
    assert file.read_bytes() == damaged


def test_without_metrics_a_resumed_run_says_that_rows_begin_anew(interrupted, capsys):
    file, step = interrupted / "metrics.csv", last(interrupted)["env_steps"]
    file.unlink()
    stopped = [f"steps={step}"]  # nothing is left to do, so that there are no rows yet
    for overrides in (stopped, ["steps=400"]):
        train("smoke", resume=interrupted, overrides=overrides, quiet=True)
        assert f"metrics.csv has no rows: they begin at {step} env steps" in capsys.readouterr().err
    assert read(file)[0]["env_steps"] > step
    train("smoke", resume=interrupted, quiet=True)
    assert capsys.readouterr().err == ""


def test_a_picture_of_damaged_metrics_is_refused_by_name(tmp_path):
    path = tmp_path / "metrics.csv"
    for content in (b"\xff\xfe", b"step,loss\n1,much\n", b"step,loss\n1,2,3\n"):
        path.write_bytes(content)
        with pytest.raises(ConfigError, match=r"metrics\.csv is no table of numbers"):
            read(path)


def test_a_page_that_is_written_meanwhile_changes_nothing_that_is_learned(tmp_path, world):
    watched = []
    runs = [
        train("smoke", overrides=TINY, runs=tmp_path / name, seed=7, quiet=True, watch=watch)
        for name, watch in (("alone", None), ("watched", watched.append))
    ]
    assert set(watched) == {runs[1]}
    states = [(run / "checkpoints/last.safetensors").read_bytes() for run in runs]
    assert states[0] == states[1]
