"""What is searched: texts of --search, defaults of recipes, and what is refused."""

import pytest

pytest.importorskip("optuna")

from optuna.distributions import CategoricalDistribution, FloatDistribution, IntDistribution

from spikedeploy.campaign.search_space import parse_search
from spikedeploy.campaign.tune import TuningPlan
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.trainers.recipes import RECIPES


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("learning_rate=1e-4..1e-2:log", FloatDistribution(1e-4, 1e-2, log=True)),
        ("epochs=3..12", IntDistribution(3, 12)),
        ("gamma=0.9..1", FloatDistribution(0.9, 1.0)),
        ("policy.hidden=[8]|[16,16]", CategoricalDistribution(("[8]", "[16,16]"))),
    ],
)
def test_ranges_and_choices_are_read_as_they_are_written(text, found):
    assert parse_search(text) == (text.partition("=")[0], found)


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("gamma", "--search takes KEY="),
        ("gamma=0.9", "--set takes a single value"),
        ("gamma=0.9|", "nothing to choose"),
        ("gamma=0.9..x", "must be numbers"),
        ("gamma=0.9..nan", "must be numbers"),
        ("gamma=0.9..0.9", "lower one first"),
        ("gamma=0.9..0.1", "lower one first"),
        ("gamma=0..0.9:log", "begins above 0"),
    ],
)
def test_a_text_that_says_nothing_is_refused(text, why):
    with pytest.raises(ConfigError, match=f"--search.*{why}" if why[0] != "-" else why):
        parse_search(text)


@pytest.mark.parametrize("recipe", RECIPES)
def test_every_recipe_has_a_default_space_whose_ends_it_takes(recipe):
    env = "CartPole-v1" if RECIPES[recipe].any_env else ""
    first = TuningPlan(recipe, env)
    asked = tuple(f"{key}={_text(search)}" for key, search in first.space.items())
    assert asked
    assert TuningPlan(recipe, env, search=asked).space == first.space  # both ends are settings


def _text(search):
    if isinstance(search, CategoricalDistribution):
        return "|".join(search.choices)
    return f"{search.low}..{search.high}" + ":log" * search.log


@pytest.mark.parametrize(
    ("fields", "why"),
    [
        ({"recipe": "smok"}, "did you mean smoke"),
        ({"recipe": "smoke", "env": "CartPole-v1"}, "leave --env out"),
        ({"recipe": "ppo-snn"}, "--env"),
        ({"recipe": "smoke", "objective": "return,sops"}, "float policy"),
        ({"recipe": "smoke", "episodes": 1_001}, "--episodes"),
        ({"recipe": "smoke", "search": ("gama=0.9..0.99",)}, "did you mean gamma.*critic_hidden"),
        (
            {"recipe": "smoke", "fixed": ("gamma=0.9",), "search": ("gamma=0.9..0.99",)},
            "searched and fixed",
        ),
    ],
)
def test_a_plan_that_makes_no_sense_is_refused(fields, why):
    with pytest.raises(ConfigError, match=why):
        TuningPlan(**fields).space  # noqa: B018


def test_what_is_fixed_is_not_searched():
    space = TuningPlan("smoke", fixed=("gamma=0.9",)).space
    assert "gamma" not in space
    assert "tau" in space


def test_the_command_of_a_trial_trains_with_its_settings():
    plan = TuningPlan("ppo-snn", "CartPole-v1", fixed=("steps=99",), seed=3)
    assert plan.command({"policy.hidden": "[8,8]", "gamma": 0.9}) == (
        "spikedeploy train CartPole-v1 --recipe ppo-snn --set steps=99 "
        "--set 'policy.hidden=[8,8]' --set gamma=0.9 --seed 3"
    )
