"""A training of the pareto experiment: found, resumed, started, or refused."""

import json

import pytest

from lab.experiments.pareto import page, training, tuning
from lab.experiments.pareto.design import ParetoDesign
from lab.experiments.pareto.design import asked as design_of
from lab.experiments.pareto.experiment import experiment
from lab.experiments.pareto.training import Training, perform
from lab.experiments.pareto.tuning import RewardTraining
from spikedeploy.jobs import resumable
from spikedeploy.runtime.errors import ChipError, ConfigError
from spikedeploy.trainers import train
from spikedeploy.trainers.run_folder import RunFolder
from spikedeploy.trainers.sparse.config import phases

RECIPE = "kart-grid-sparse"


@pytest.fixture
def asked(tmp_path):
    return Training(RECIPE, 1, str(tmp_path), ("walks=7",), "")


@pytest.fixture
def baseline(tmp_path):
    return Training("kart-grid-small-mlp", 1, str(tmp_path), (), RECIPE)


@pytest.fixture
def calls(monkeypatch):
    """What the trainer was asked for; it does nothing."""
    found = []
    monkeypatch.setattr(train, "train", lambda *words, **options: found.append((words, options)))
    return found


def leave(asked, updates, seed=1):
    """A run folder with so many updates made; None leaves no checkpoint."""
    config = asked.planned([]).model_copy(update={"seed": seed})
    run = RunFolder.create(asked.folder, config).path
    if updates is not None:
        (run / "checkpoints/last.json").write_text(json.dumps({"updates": updates}))
    return run


def whole(asked):
    return phases(asked.planned([]))[-1].end


def test_a_training_that_is_missing_is_started_with_its_settings(asked, calls):
    assert perform(**asked.arguments()) is False  # the trainer of this test makes no updates
    ((words, options),) = calls
    assert words == (RECIPE,)
    assert (options["seed"], options["overrides"]) == (1, ["walks=7"])


def test_an_unfinished_training_is_resumed(asked, calls):
    leave(asked, whole(asked), seed=2)  # of another seed
    run = leave(asked, whole(asked) - 1)
    assert perform(**asked.arguments()) is False
    assert calls[0][1]["resume"] == run


def test_a_run_without_a_checkpoint_is_started_anew(asked, calls):
    run = leave(asked, None)
    perform(**asked.arguments())
    assert "resume" not in calls[0][1]
    assert not run.exists()


def test_a_finished_training_is_reused_whatever_lies_beside_it(asked, calls):
    run = leave(asked, whole(asked))
    leave(asked, 3)
    assert perform(**asked.arguments()) is True
    assert (asked.run, calls) == (run, [])


def test_a_baseline_takes_over_the_walks_of_the_finished_spiking_run(baseline, asked, calls):
    with pytest.raises(ConfigError, match="learns from the walks of kart-grid-sparse-s1"):
        perform(**baseline.arguments())
    run = leave(asked, whole(asked))
    perform(**baseline.arguments())
    assert calls[0][1]["overrides"] == [f'pool="{run}"', "teacher_walks=0", "noisy_walks=0"]


def test_settings_that_are_not_the_recipes_are_named(asked):
    leave(asked, whole(asked))
    assert asked.changed_settings == []
    now = Training(RECIPE, 1, asked.folder, ("walks=8",), "")
    assert now.changed_settings == ["walks=7"]


def test_levels_begin_with_the_most_operations(asked):
    run = leave(asked, whole(asked))
    for name in ("ops-70", "ops-105", "ops-1e+03", "best", "last"):
        (run / f"checkpoints/{name}.safetensors").touch()
    assert asked.levels == ["ops-1e+03", "ops-105", "ops-70"]
    assert training.operations_of("ops-1e+03") == 1000


# with reward


def tuned(start):
    return RewardTraining("kart-grid-sparse-tuned", start, ("iterations=5",))


def leave_tuned(asked, start, iterations):
    """A run folder that began at the named run, with so many iterations made."""
    config = asked.planned([f"start={start}"])
    run = RunFolder.create(asked.folder, config).path
    if iterations is not None:
        (run / "checkpoints/last.json").write_text(json.dumps({"iterations": iterations}))
    return run


def test_a_training_with_reward_waits_for_its_start_and_begins_there(asked, calls):
    with pytest.raises(ConfigError, match="kart-grid-tuned-sparse-s1 goes on from kart-grid-spars"):
        tuning.perform(**tuned(asked).arguments())
    run = leave(asked, whole(asked))
    arguments = json.loads(json.dumps(tuned(asked).arguments()))  # as a job passes them
    assert tuning.perform(**arguments) is False
    ((words, options),) = calls
    assert words == ("kart-grid-sparse-tuned",)
    assert (options["seed"], options["overrides"]) == (1, ["iterations=5", f'start="{run}"'])


def test_runs_with_reward_are_told_apart_by_the_runs_that_they_began_at(asked, baseline, calls):
    starts = {each: leave(each, whole(each)).name for each in (asked, baseline)}
    leave_tuned(tuned(asked), "", None)  # refused, and left without a start
    leave_tuned(tuned(asked), "gone-s1", 5)
    mine = leave_tuned(tuned(asked), starts[asked], 5)
    theirs = leave_tuned(tuned(baseline), starts[baseline], 4)
    assert (tuned(asked).run, tuned(baseline).run) == (mine, theirs)
    assert (tuned(asked).trained, tuned(baseline).trained) == (True, False)
    assert tuned(baseline).progress == (4, 5)
    assert tuning.perform(**tuned(asked).arguments()) is True
    assert calls == []
    tuning.perform(**tuned(baseline).arguments())
    assert calls[0][1]["resume"] == theirs


def test_reward_from_an_earlier_level_of_pruning_is_a_training_of_its_own(asked, calls):
    run = leave(asked, whole(asked))
    plain = tuned(asked)
    early = RewardTraining(plain.recipe, plain.start, plain.overrides, "ops-45")
    assert early.name == "kart-grid-tuned-sparse-ops-45-s1"
    assert early.operations_of("best") == 45
    mine = leave_tuned(plain, run.name, 5)
    assert (plain.run, early.run) == (mine, None)
    assert tuning.perform(**json.loads(json.dumps(early.arguments()))) is False
    assert calls[0][1]["overrides"] == [
        "iterations=5", f'start="{run}"', "start_checkpoint=ops-45"
    ]  # fmt: skip
    theirs = leave_tuned(early, run.name, 5)
    assert (plain.run, early.run) == (mine, theirs)
    assert early.trained
    assert early.changed_settings == []


def test_the_command_tasks_baseline_goes_on_from_300_operations_too(tmp_path):
    names = [each.name for each in ParetoDesign("hexapod-command", 1, str(tmp_path)).tunings()]
    baselines = [name for name in names if "small-mlp" in name]
    assert baselines == [f"hexapod-command-tuned-small-mlp{x}-s0" for x in ("", "-ops-300")]


def test_settings_of_trainings_with_reward_have_a_name_of_their_own(tmp_path):
    settings = ("walks=7", "tuned.iterations=9", "env.options.laps=2")
    design = ParetoDesign("kart-grid", 1, str(tmp_path), settings)
    assert design.overrides == ("walks=7", "env.options.laps=2")
    assert design.tuned_overrides == ("iterations=9", "env.options.laps=2")
    assert design.tunings()[0].planned([]).iterations == 9
    names = [each.name for each in ParetoDesign("kart-grid", 2, str(tmp_path)).everything()]
    assert names[4:7] == [
        "kart-grid-small-linear-s0", "kart-grid-tuned-sparse-s0",
        "kart-grid-tuned-sparse-linear-s0",
    ]  # fmt: skip
    assert names[9] == "kart-grid-sparse-s1"


# refused before anything runs


@pytest.fixture
def started(monkeypatch):
    """The names of the jobs that were started; they do nothing."""
    names = []
    monkeypatch.setattr(
        resumable, "run", lambda jobs, *_: names.extend(job.name for job in jobs) or True
    )
    monkeypatch.setattr(page, "write", lambda design, results: [results / "pareto.md"])
    return names


def test_an_unknown_chip_is_refused_with_the_design(tmp_path):
    with pytest.raises(ChipError, match="no chip 'nope'"):
        design_of({"env": "kart-grid", "chip": "nope", "runs": str(tmp_path)})


@pytest.mark.parametrize(
    ("only", "missing"),
    [
        ("kart-grid-sparse-linear-s0", "learns from the walks of kart-grid-sparse-s0, which is no"),
        ("kart-grid-tuned-sparse-s0", "goes on from kart-grid-sparse-s0, which is not trained yet"),
        ("kart-grid-sparse-s0: levels", "evaluates kart-grid-sparse-s0, which is not trained yet"),
    ],
)
def test_a_part_whose_training_before_is_missing_is_refused_at_the_start(
    only, missing, started, tmp_path
):
    design = ParetoDesign("kart-grid", 1, str(tmp_path / "runs"), quick=True)
    with pytest.raises(ConfigError, match=missing):
        experiment(design, [only], 1, tmp_path / "results")
    assert started == []
    assert not list(tmp_path.iterdir())
    experiment(design, [only, "kart-grid-sparse-s0"], 1, tmp_path / "results")
    assert {"kart-grid-sparse-s0", only} <= set(started)


def test_a_part_of_a_training_that_is_there_needs_nothing_more(started, asked, tmp_path):
    leave(asked, whole(asked))
    design = ParetoDesign("kart-grid", 2, str(tmp_path), asked.overrides)
    experiment(design, ["kart-grid-sparse-linear-s1"], 1, tmp_path / "results")
    assert started[0] == "kart-grid-sparse-linear-s1"


def test_files_in_place_of_folders_are_refused_at_the_start(started, tmp_path):
    (file := tmp_path / "file").touch()
    for runs, results, option in (
        (file, tmp_path / "results", "--runs"),
        (tmp_path / "runs", file, "--output"),
        (tmp_path / "runs", file / "results", "--output"),
    ):
        design = ParetoDesign("kart-grid", 1, str(runs), quick=True)
        with pytest.raises(ConfigError, match=rf"{option} .*: .*file is a file\. Name a folder"):
            experiment(design, (), 1, results)
    assert started == []
