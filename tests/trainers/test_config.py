import pytest

from spikedeploy.runtime.errors import ConfigError
from spikedeploy.trainers import ALGORITHMS
from spikedeploy.trainers.config import Ramp, differences, parse_override, resolve
from spikedeploy.trainers.ppo import PpoConfig
from spikedeploy.trainers.recipes import RECIPES
from spikedeploy.trainers.sac import SacConfig
from spikedeploy.trainers.sparse.settings import SparseConfig
from spikedeploy.trainers.sparse.sparse import with_budget
from spikedeploy.trainers.sparse.sparse_ppo import SparsePpoConfig
from spikedeploy.trainers.train import algorithm


@pytest.mark.parametrize("recipe", RECIPES)
def test_every_recipe_resolves_and_survives_json(recipe):
    model = algorithm(RECIPES[recipe].algorithm).Config
    config = resolve(model, recipe, seed=3)
    assert model.model_validate_json(config.model_dump_json()) == config
    assert (config.recipe, config.seed) == (recipe, 3)


@pytest.mark.parametrize("name", ALGORITHMS)
def test_every_algorithm_names_its_metrics_and_its_configuration(name):
    kind = algorithm(name)
    recipe = next(recipe for recipe, entry in RECIPES.items() if entry.algorithm == name)
    columns = kind.columns(resolve(kind.Config, recipe))
    assert len(columns) == len(set(columns)) > 2


def test_overrides_win_over_the_file_which_wins_over_the_recipe(tmp_path):
    file = tmp_path / "mine.toml"
    file.write_text("batch = 32\n[policy]\nhidden = [64]\n[env.options]\npushes = 0.5\n")
    config = resolve(SacConfig, "hexapod-sac", file=file, overrides=["batch=16", "tau=0.01"])
    assert (config.batch, config.tau, config.policy.hidden) == (16, 0.01, (64,))
    assert config.env.options == {"pushes": 0.5}


@pytest.mark.parametrize("text", [None, "batch = \n"])
def test_a_missing_or_broken_file_is_refused_by_name(tmp_path, text):
    file = tmp_path / "broken.toml"
    if text is not None:
        file.write_text(text)
    with pytest.raises(ConfigError, match=r"broken\.toml"):
        resolve(SacConfig, "smoke", file=file)


def test_override_values_are_toml_and_else_text():
    assert parse_override("a.b=[1, 2]") == {"a": {"b": [1, 2]}}
    assert parse_override("a=5e4") == {"a": 50_000.0}
    assert parse_override("a=hexapod-command") == {"a": "hexapod-command"}


def test_a_ramp_is_flat_outside_and_linear_inside():
    ramp = Ramp(start=1.0, end=0.0, begin=100, finish=200)
    assert [ramp.value(step) for step in (0, 100, 150, 200, 900)] == [1.0, 1.0, 0.5, 0.0, 0.0]


def test_differences_from_a_recipe_rebuild_the_configuration():
    chosen = ["policy.hidden=[8]", "steps=300", "env.name=elsewhere", "support_force.finish=7"]
    config = resolve(SacConfig, "smoke", overrides=chosen, seed=3)
    found = differences(config)
    assert sorted(found) == sorted([*chosen[:2], 'env.name="elsewhere"', chosen[3]])
    assert resolve(SacConfig, "smoke", overrides=found, seed=3) == config
    assert differences(resolve(SacConfig, "smoke")) == []


@pytest.mark.parametrize(
    ("recipe", "override", "message"),
    [
        ("hexapod-sca", "", "did you mean hexapod-sac"),
        ("smoke-popsan", "wind=0.1", r"'wind'.* is env\.options\.wind"),
        ("smoke-popsan", "policy.hiden=[64]", "did you mean hidden"),
        ("smoke-popsan", "batch=0", "batch: .* got 0"),
        ("smoke-popsan", "batch", "--set takes key=value"),
        ("smoke-popsan", "policy.surrogate=sigmoid", "surrogate"),
        ("smoke-popsan", "validation.first_seed=10000", "validation.first_seed"),
        ("smoke", "learning_rate=inf", "finite"),
        ("smoke-sparse", "budget=inf", "budget: .* finite number, got inf"),
        ("smoke-sparse", "levels=[inf]", "levels.0: .* finite"),
        ("smoke-sparse", "policy.most=300", "most: .* got 300"),
        ("smoke-sparse", "policy.timesteps=1025", "timesteps: .* got 1025"),
        ("smoke-sparse", "burn_in=20", r"window: 20 .* burn_in \(20\)"),
        ("distill-sparse", "confirm=4980", "confirm: .* at most 4,970"),
        ("smoke-sparse-tuned", "gamma=nan", "gamma: "),
        ("smoke-sparse-tuned", "noise=[inf,0.1]", "noise.0: .* finite"),
        ("smoke-sparse-tuned", "burn_in=16", "window: 16 is less than twice"),
    ],
)
def test_a_wrong_setting_is_refused_in_one_sentence(recipe, override, message):
    models = {"smoke-sparse-tuned": SparsePpoConfig, "smoke-sparse": SparseConfig}
    model = {**models, "distill-sparse": SparseConfig}.get(recipe, SacConfig)
    with pytest.raises(ConfigError, match=message) as error:
        resolve(model, recipe, overrides=[override] * bool(override))
    assert "\n" not in str(error.value)


def test_a_training_without_any_walks_is_refused():
    none = ["teacher_walks=0", "noisy_walks=0"]
    with pytest.raises(ConfigError, match=r"both are 0, .* or pool=RUN"):
        resolve(SparseConfig, "smoke-sparse", overrides=none)
    assert resolve(SparseConfig, "smoke-sparse", overrides=[*none, "pool=a-run"]).pool == "a-run"


def test_a_recipe_for_any_environment_stretches_its_schedules_with_its_length():
    short, long = (
        resolve(PpoConfig, "ppo-snn", overrides=changes)
        for changes in ([], ["steps=1000000", "actor_rate.start=0.01"])
    )
    assert (short.steps, long.steps) == (100_000, 1_000_000)
    assert (long.actor_rate.start, long.actor_rate.finish) == (0.01, 1_000_000)
    for name in ("actor_rate", "entropy", "temperature"):
        before, after = getattr(short, name), getattr(long, name)
        assert (after.begin, after.finish) == (10 * before.begin, 10 * before.finish)
    assert long.normaliser.finish == 10 * short.normaliser.finish
    kept = resolve(PpoConfig, "ppo-snn", overrides=["steps=200000", "entropy.finish=7"])
    assert kept.entropy.finish == 7
    assert resolve(SacConfig, "hexapod-sac", overrides=["steps=1"]).temperature.finish == 180_000


@pytest.mark.parametrize("student", ["sparse", "small-mlp", "small-linear"])
def test_the_levels_of_any_environment_follow_its_budget(student):
    config = resolve(SparseConfig, f"distill-{student}", overrides=['env.name="CartPole-v1"'])
    assert (config.search, config.budget) == (True, 0)
    unit = "sops" if student == "sparse" else "macs"
    assert with_budget(config, f"{unit}=40").levels_in_order == (120.0, 80.0, 60.0, 48.0, 40.0)
