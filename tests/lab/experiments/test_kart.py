"""The kart experiment: what belongs to it, what its page says, what is left to do."""

import json
import shlex
import sys
from dataclasses import replace

import pytest
from matplotlib.figure import Figure

from lab.experiments import kart, kart_page
from lab.experiments.kart import HELD, NTH, TRACKS, UNSEEN, WORLDS, KartDesign
from lab.experiments.kart_page import (
    finish_share,
    heldout_verdicts,
    learning_verdicts,
    share,
    steps,
)
from lab.experiments.kart_trainings import unpack
from lab.experiments.runner import run_experiment
from spikedeploy.jobs import resumable
from spikedeploy.jobs.resumable import JobEnd
from spikedeploy.runtime.errors import ConfigError
from tests import toy_race_env
from tests.job_functions import in_this_process
from tests.lab.versions import without_version
from tests.paths import ROOT

RESULTS = ROOT / "results"
TABLES = [f"kart/{name}.csv" for name in ("learning", "driving", "tracks", "finishes")]
NUMBERS = {
    "episodes": 100, "lap_time": 7.5, "crashes": 0.02, "stalls": 0.0, "gates": 7.9,
    "return_mean": 20.0, "macs_dense": 1000.0, "energy_per_inference_j": {"horowitz45": 1e-7},
}  # fmt: skip


@pytest.fixture
def race(monkeypatch):
    toy_race_env.install(monkeypatch, *WORLDS)


@pytest.fixture
def design(tmp_path, race):
    return KartDesign(seeds=2, controls=1, runs=str(tmp_path / "runs"))


@pytest.fixture
def pretend(monkeypatch):
    """Let every job leave at once what it would after hours; the names of those that ran."""
    ran = []
    monkeypatch.setattr(kart_page, "finishes_figure", lambda design: Figure(figsize=(1, 1)))

    def run(jobs, count, ended, look=None):
        for job in jobs:
            ran.append(job.name)
            leave_part(KartDesign(**job.arguments["design"]), job.name)
            ended(JobEnd(job, 1.0, 0))
        return True

    monkeypatch.setattr(resumable, "run", run)
    return ran


def driven(chip=None, rate=0.98, **changes):
    return {**NUMBERS, "chip": chip, "success_rate": rate, **changes}


def leave_part(design, name):
    """What a part leaves: whoever learned in corridors finishes everywhere, others on big_S."""
    driver = next(
        each
        for each in (*design.scripts(), *design.trainings())
        if each.name == name.removesuffix("-tracks")
    )
    if name.endswith("-tracks"):
        everywhere, starts = "corridor" in name, design.starts
        (row,) = driver.tracks(starts)
        row.write({track: [int(everywhere or track == "big_S")] * starts for track in TRACKS})
    elif driver in design.scripts():
        driver.stored()[0].write({"rows": [driven(rate=0.1)]})
    else:
        leave(driver)


def leave(trial, first=1_000, gap=1_000):
    """What a complete trial leaves: a finish every `gap` steps, the SNN's twice as far apart."""
    snn = trial.recipe.endswith("snn")
    gap, run = gap * (2 if snn else 1), trial.run
    if run is None:
        from spikedeploy.trainers.run_folder import RunFolder

        run = RunFolder.create(trial.folder, trial.config).path
    ends = [first + trial.seed + gap * k for k in range(300)]
    text = "".join(f"{end},1\n" for end in ends)
    (run / "episodes.csv").write_text("env_steps,finish\n" + text)
    (run / "checkpoints/last.json").write_text(
        json.dumps({"env_steps": ends[-1], "finishes": len(ends), "held": 2})
    )
    shares = "".join(f"{k}0000,{share}\n" for k, share in enumerate((0, 0.95, 0.5, 1, 0.95), 1))
    (run / "metrics.csv").write_text("env_steps,eval_finish\n" + shares)
    (run / f"policy.{'nir' if snn else 'onnx'}").write_text(trial.name)
    rows = [driven()]
    if snn:
        beside = {"success_difference_mean": -0.01, "actions_equal": 0.97}
        rows = [driven("float"), driven("loihi1", 0.97, sops_per_inference=2000.0, **beside)]
    trial.stored()[0].write({"parameters": 25_000, "rows": rows})


def test_only_the_classic_preset_ends_when_its_own_metric_is_reached(design):
    ends = {trial.name: trial.config for trial in design.trainings()}
    classic, default = ends["kart-grid-classic-snn-s0"], ends["kart-grid-snn-s0"]
    assert (classic.stop_at_finishes, classic.stop_at_greedy) == (300, 0)
    assert (default.stop_at_finishes, default.stop_at_greedy) == (0, 0)
    # shares in steps of 5 %, so that 95 % is one of them
    assert {(c.validation.every, c.validation.episodes) for c in ends.values()} == {(10_000, 20)}


def test_the_whole_experiment_is_done_once(design, pretend, tmp_path):
    outcome = run_experiment(design, (), 2, tmp_path / "results")
    # 54 trainings, 3 scripts; 36 trainings and 3 scripts on all tracks
    assert (outcome.done, outcome.of, outcome.failed) == (96, 96, {})
    assert len(pretend) == 96
    assert all(path.is_file() for path in outcome.files)
    before = outcome.files[0].read_text()
    again = run_experiment(design, (), 2, tmp_path / "results")
    assert (again.done, len(pretend)) == (96, 96)  # nothing was left to do
    assert again.files[0].read_text() == before


def test_parts_are_chosen_by_the_beginnings_of_their_names(design, pretend, tmp_path):
    outcome = run_experiment(design, ["kart-grid-snn", "kart-steer-ann-s1"], 2, tmp_path)
    trained = ["kart-grid-snn-s0", "kart-grid-snn-s1", "kart-steer-ann-s1"]
    assert pretend == [*trained, *(f"{name}-tracks" for name in trained)]
    assert outcome.done == 6
    assert "**6 of 96 parts are complete.**" in outcome.files[0].read_text()
    run_experiment(design, ["*-classic-snn-s0"], 2, tmp_path)
    assert pretend[6:] == [f"{world}-classic-snn-s0" for world in WORLDS]
    with pytest.raises(ConfigError, match=r"begins with 'kart-grit'; known: kart-grid-"):
        run_experiment(design, ["kart-grit"], 2, tmp_path)


def test_a_part_that_fails_is_named_with_its_last_words(design, monkeypatch, tmp_path):
    def run(jobs, count, ended, look=None):
        jobs[0].log.parent.mkdir(parents=True)
        jobs[0].log.write_text("a long story\nerror: no memory\n")
        ended(JobEnd(jobs[0], 1.0, 1))
        return True

    monkeypatch.setattr(resumable, "run", run)
    outcome = run_experiment(design, ["kart-grid-ann-s0"], 1, tmp_path)
    assert outcome.failed == {"kart-grid-ann-s0": "error: no memory"}


def test_a_share_of_finishes_has_an_interval_over_trainings_and_starts():
    apart = finish_share([[1] * 50, [0] * 50])
    assert (apart.mean, apart.ci95) == (0.5, (0.0, 1.0))
    agreed = finish_share([[1] * 30 + [0] * 20] * 3)
    assert 0.45 < agreed.ci95[0] < agreed.mean == 0.6 < agreed.ci95[1] < 0.73


def tracks_rows(policy, share, seed=0):
    return [
        {
            "world": "kart-grid", "preset": "corridor" if seed is not None else "default",
            "policy": policy, "seed": seed, "chip": None, "track": track,
            "unseen": track not in ("corridor-8", "big_S"),
            # what happens on tracks that are trained on must not count
            "finished": [int(k < 10 * share) for k in range(10)]
            if track not in ("corridor-8", "big_S") else [1] * 10,
        }
        for track in TRACKS
    ]  # fmt: skip


def test_held_out_sentences_count_only_tracks_that_nothing_was_trained_on():
    rows = tracks_rows("ann", 0.8) + tracks_rows("snn", 0.4) + tracks_rows("gap", 0.5, None)
    said = heldout_verdicts(rows)
    assert said[0].startswith(
        "- ✓ held-out tracks, kart-grid: ann, trained in corridors, finishes 80%"
    )
    assert said[1].startswith(
        "- ✗ held-out tracks, kart-grid: snn, trained in corridors, finishes 40%"
    )
    assert said[1].endswith("the gap follower 50%")
    assert said[2].startswith("- ✗ held-out tracks, kart-grid: the SNN reaches 50.0%")
    neither = tracks_rows("ann", 0.0) + tracks_rows("snn", 0.0) + tracks_rows("gap", 0.5, None)
    assert len(heldout_verdicts(neither)) == 2


def test_a_training_that_never_came_so_far_counts_as_longer_than_it_was():
    never = float("inf")

    def rows(*values):
        return [{NTH: value, "env_steps": 500_000 + k} for k, value in enumerate(values)]

    assert steps(rows(1_000, 2_000, never), NTH) == "2k [1k, > 500k]"
    assert steps(rows(never, never, 1_000), NTH) == "> 500k [1k, > 500k]"
    early = {NTH: never, "env_steps": 400}  # it could be any of the three numbers
    assert steps([early, *rows(1_000, 2_000)], NTH) == "> 1k [> 0k, > 2k]"
    found = [
        {
            "world": "kart-grid", "preset": "default", "policy": policy, NTH: value,
            "first_finish": 1.0, HELD: 7.0, "env_steps": 500_000,
        }
        for policy, value in [
            ("ann", 100.0), ("ann", 100.0), ("snn", 200.0), ("snn", never), ("snn", 100.0)
        ]
    ]  # fmt: skip
    assert str(share(found, "kart-grid")) == "≤ 50.0% [0%, 100%]"
    assert share(found[:1], "kart-grid") is None
    *_, to_finishes, greedily = learning_verdicts(found)
    assert to_finishes.startswith("- ≈ default, kart-grid: the SNN reaches ≤ 50.0%")
    assert "greedy 95%" in greedily
    turned = [{**row, "policy": {"ann": "snn", "snn": "ann"}[row["policy"]]} for row in found]
    assert str(share(turned, "kart-grid")) == "≥ 200.0% [100%, 500000%]"
    assert learning_verdicts(turned)[-2].startswith("- ✓ default, kart-grid: the SNN reaches ≥ 200")
    both = [*found, {**found[0], NTH: never}]
    assert share(both, "kart-grid") is None
    assert learning_verdicts(both)[-2] == (
        "- ≈ default, kart-grid: trainings that came to 300 finishes: 2 of 3 ann, 2 of 3 snn; no "
        "share of steps"
    )


def test_a_page_with_trainings_that_are_not_here_is_not_written_over(design, pretend, tmp_path):
    files = run_experiment(design, ["kart-grid-ann-s0", "kart-grid-snn-s0"], 1, tmp_path).files
    before = {path: path.read_bytes() for path in files}
    run_experiment(design, ["kart-grid-ann-s0"], 1, tmp_path)
    others = {"runs": f"{design.runs}-b"}, {"seeds": 0}, {"episodes": 3}, {"chip": "xylo-a2"}
    for other in (replace(design, **changed) for changed in others):
        with pytest.raises(ConfigError, match=r"kart\.md have \d+ rows that new ones .* -o"):
            run_experiment(other, ["kart-grid-ann-s0"], 1, tmp_path, train=False)
    assert {path: path.read_bytes() for path in files} == before


def test_the_command_tells_machines_and_people(design, pretend, monkeypatch, tmp_path, lab):
    monkeypatch.chdir(tmp_path)
    words = ("experiment", "kart", "--seeds", "1", "--controls", "0", "--only", "kart-grid")
    (code, first, _), (again, rest, _) = lab(*words, "--json"), lab(*words)
    assert (code, again) == (0, 0)
    # ann, snn of three presets, a script; tracks of all but the classic ones
    assert json.loads(first)["done"] == 6 + 1 + 5
    assert rest.startswith("12 of 36 parts are complete: results/kart.md")
    assert "unknown experiment 'cart'; known: kart" in lab("experiment", "cart")[2]


# tracks


@pytest.fixture
def short(monkeypatch):
    """Two tracks, one of them with starts of its own."""
    monkeypatch.setattr(kart, "TRACKS", ("big_S", "small_S"))


def test_the_gap_follower_finishes_where_it_was_tuned_and_not_everywhere(tmp_path, short):
    script = kart.Script("kart-gazebo", "gap", str(tmp_path), 3)
    (row,) = script.tracks(2)
    row.complete()
    assert row.found == {"big_S": [1, 1], "small_S": [0, 0]}
    assert script.tracks(3)[0].found is None


def test_unseen_tracks_are_those_that_no_recipe_is_trained_on():
    from spikedeploy.trainers.recipes import RECIPES

    trained = {
        recipe.settings["env"].get("options", {}).get("track", "big_S")
        for recipe in RECIPES.values()
        if recipe.algorithm == "ppo" and recipe.settings["env"]["name"].startswith("kart-")
    }
    assert trained == {"big_S", "corridor-8"}
    assert not trained & set(UNSEEN)


def test_a_first_look_trains_evaluates_and_writes_the_page(tmp_path, monkeypatch, short):
    monkeypatch.setattr(resumable, "run", in_this_process([]))
    design = KartDesign.of({"quick": True, "runs": str(tmp_path / "runs")})
    only = ["kart-gazebo-corridor-snn", "kart-gazebo-small", "kart-gazebo-classic-ann"]
    outcome = run_experiment(design, [*only, "kart-gazebo-gap"], 1, tmp_path)
    assert outcome.failed == {}
    assert outcome.done == 3 + 2 + 2  # trainings, their tracks, and the script's two
    page = outcome.files[0].read_text()
    assert "| kart-gazebo | corridor-8 | snn · loihi1 | 1 |" in page
    assert "| kart-gazebo | – | gap | – |" in page


# the published page


def command():
    """The words of the command at the top of the page."""
    lines = (RESULTS / "kart.md").read_text("utf-8").splitlines()
    return next(shlex.split(line) for line in lines if line.startswith("    python"))


@pytest.fixture(scope="module")
def remade(tmp_path_factory):
    """A folder with the page and its tables, made of the archives by the page's own command."""
    folder = tmp_path_factory.mktemp("kart")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.setattr(sys, "argv", command())
        design = KartDesign.of({})
        for archive in sorted((RESULTS / "kart/trainings").glob("*.zip")):
            unpack(archive, folder / design.runs)
        design.write(folder / "results")
    return folder / "results"


@pytest.mark.parametrize("name", ["kart.md", *TABLES])
def test_the_page_is_made_of_the_archives(name, remade):
    made, kept = ((folder / name).read_text("utf-8") for folder in (remade, RESULTS))
    assert without_version(made) == without_version(kept)
