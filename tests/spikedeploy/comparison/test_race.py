"""Comparisons of karts: finishes, laps, crashes, choices that are equal or not."""

import numpy as np
import pytest

from spikedeploy import envs
from spikedeploy.comparison.episode_metrics import measure
from spikedeploy.comparison.episodes import (
    Agreement,
    agreement,
    pooled_equality,
    pooled_rmse,
)
from spikedeploy.comparison.evaluation import compare_policies, line_up, run_policy
from spikedeploy.envs.rollout import Rollout
from spikedeploy.evaluation_setup import Setup
from spikedeploy.policies.registry import Entry, find, open_policy
from spikedeploy.reports.columns import tables
from spikedeploy.reports.summary import summary
from spikedeploy.runtime.errors import ConfigError, EnvError
from tests import toy_race_env

SEEDS = range(10_000, 10_004)


@pytest.fixture(autouse=True)
def _race(monkeypatch):
    toy_race_env.install(monkeypatch)


class Quadrants:
    """Chooses right, save every so many steps."""

    def __init__(self, wrong_every):
        self.wrong_every = wrong_every

    def reset(self, seed):
        self.step = 0

    def act(self, observation):
        return self.replay(observation[None])[0]

    def replay(self, observations):
        steps = 1 + np.arange(len(observations))
        right = (observations[:, 0] > 0) + 2 * (observations[:, 1] > 0)
        return np.where(steps % self.wrong_every == 0, (right + 1) % 4, right)


def played(actions, seed=0, observations=None):
    count = len(actions)
    seen = np.zeros((count + 1, 2)) if observations is None else observations
    return Rollout("x", seed, seen, np.array(actions), np.zeros(count), True, False, {})


def row(policy, kind, chip=None, rate=1.0, **changes):
    plain = {
        "policy": policy, "kind": kind, "chip": chip, "success_rate": rate, "gates": 8.0,
        "return_mean": 30.0, "ratio_to_reference": None, "difference_mean": None,
        "reference": "x", "success_difference_mean": -0.01,
        "success_difference_ci95": (-0.03, 0.0), "episodes": 100,
        "training_seeds": None if policy in ("random", "gap") else 1,
        "successes": [place < 100 * rate for place in range(100)],
        "sops_per_inference": 28.2, "effective_macs": 0.0,
    }  # fmt: skip
    return {**plain, **changes}


def test_random_players_draw_by_the_seed_of_the_episode():
    world = envs.make("race")
    player = open_policy(find("random"), None, world)
    found = []
    for seed in (1, 1, 2):
        player.reset(seed)
        found.append([int(player.act(np.zeros(2))) for _ in range(200)])
    assert found[0] == found[1] != found[2]
    assert set(found[0]) == {0, 1, 2, 3}


def test_a_line_up_shows_the_players_that_the_environment_names(monkeypatch):
    monkeypatch.setattr("spikedeploy.zoo.policies", lambda env=None: [])
    assert [entry.label for entry in line_up("race", ["random"], ())] == ["random"]
    with pytest.raises(ConfigError, match="the gait is for robots"):
        open_policy(find("gait"), None, envs.make("race"))


def test_rows_of_karts_tell_of_finishes_laps_and_crashes():
    rows = compare_policies("race", [Entry(find("random"))], SEEDS, processes=1).as_json()
    assert rows[0]["success_rate"] + rows[0]["crashes"] == 1
    assert rows[0]["failure_rate"] == np.mean(rows[0]["failures"]) == 0  # all end by the limit
    assert rows[0]["speed"] == 400
    assert "heading_error" not in rows[0]
    assert "lap_time" not in rows[0]  # by luck alone, none of four finishes
    titles = list(tables(rows))
    assert titles[0] == "Does the kart still finish?"
    heads = [column.title for column in tables(rows)[titles[0]]]
    assert heads[:4] == ["policy", "finished", "ended early", "crashes"]
    assert "CoT" not in heads


@pytest.mark.parametrize(
    ("info", "terminated", "failed"),
    [
        ({"success": [0.0, 1.0]}, True, False),  # the finish
        ({"success": [0.0, 0.0]}, True, True),  # a fall
        ({"success": [0.0, 0.0]}, False, False),  # the time limit
        ({}, True, None),  # a goal or a fall: nothing says which
    ],
)
def test_an_episode_fails_that_a_terminal_state_other_than_success_ends(info, terminated, failed):
    played = Rollout(
        "race", 0, np.zeros((3, 1)), np.zeros((2, 1)), np.zeros(2), terminated, not terminated,
        {name: np.array(values) for name, values in info.items()},
    )  # fmt: skip
    assert played.failed is failed


def test_a_lap_is_timed_only_where_it_is_format_success():
    infos = {
        "gates": np.array([0.0, 1.0]), "lap_time": np.array([0.1, 0.2]),
        "crash": np.array([0.0, 0.0]), "stalled": np.zeros(2), "speed": np.array([1.0, 3.0]),
    }  # fmt: skip
    assert "lap_time" not in measure({**infos, "finish": np.zeros(2)})
    found = measure({**infos, "finish": np.array([0.0, 1.0])})
    assert found == {"lap_time": 0.2, "crashes": 0, "stalls": 0, "gates": 1, "speed": 2.0}


def test_options_of_the_environment_reach_every_episode():
    setup = Setup(set_=("luck=9",))
    lucky = compare_policies("race", [Entry(find("random"), setup=setup)], SEEDS, 1).as_json()
    assert lucky[0]["success_rate"] == 1
    assert lucky[0]["lap_time"] == pytest.approx(10 / 60)
    (row,) = run_policy("random", "race", None, SEEDS, setup).as_json()
    assert row["crashes"] == 0


def test_an_option_that_an_environment_does_not_have_is_one_clear_line():
    with pytest.raises(EnvError, match=r"race has no option 'wings'; the docstring of"):
        envs.make("race", wings=2)


def test_choices_agree_or_they_do_not():
    seen = np.random.default_rng(0).uniform(-1, 1, (11, 2))
    right, sloppy = Quadrants(99), Quadrants(5)
    theirs, ours = right.replay(seen[:-1]), sloppy.replay(seen[:-1])
    found = agreement(sloppy, played(ours), played(theirs, observations=seen))
    assert (found.equal, found.actions, found.first_divergence) == (8, 10, 4)
    assert pooled_equality([found, Agreement(0.0, 10, None, equal=10)]) == 0.9
    assert pooled_rmse([found]) is None
    assert pooled_equality([Agreement(0.0, 10, None)]) is None


def test_the_sentences_say_what_finishes_on_the_chip_and_what_is_as_good():
    rows = [
        row("ann", "ann", rate=0.99, reference=None, effective_macs=9000.0),
        row("snn", "snn", "float", 0.98),
        row("snn", "snn", "loihi1", 0.97),
        row("random", "random", rate=0.0),
        row("gap", "control", rate=0.98),
        row("linear", "control", rate=0.6, effective_macs=139.0),
        row("small", "control", rate=0.99, effective_macs=4000.0),
    ]
    assert summary(rows) == (
        "snn on loihi1 earns 30 in 100 episodes, and succeeds in 97% of them (-1.0 points to its "
        "float twin, 95% interval -3.0 to +0.0). The smallest float policy not shown to finish "
        "less often is small: 4,000 MACs a control step, to 28 synaptic operations of snn. The "
        "script gap is not shown to finish less often either. Neuron updates and the encoder are "
        "in neither count. How often the others finish: the float ANN 99%, random actions 0%, the "
        "best control (small) 99%. Intervals cover 100 episodes of one training each; other "
        "trainings differ: results/README.md."
    )


def test_episodes_that_all_end_alike_have_no_interval():
    equal = {"success_difference_mean": 0.0, "success_difference_ci95": (0.0, 0.0)}
    said = summary([row("snn", "snn", "loihi1", 1.0, **equal)])
    assert "(+0.0 points to its float twin, the same in every episode)" in said
