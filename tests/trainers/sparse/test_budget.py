import pytest

from spikedeploy.runtime.errors import ConfigError
from spikedeploy.trainers.config import resolve
from spikedeploy.trainers.sac.learner import SacConfig
from spikedeploy.trainers.sparse.sparse import with_budget
from spikedeploy.trainers.sparse.student import SparseConfig
from spikedeploy.trainers.train import train


def sparse(recipe):
    return resolve(SparseConfig, recipe)


def test_a_budget_replaces_that_of_the_recipe_and_moves_its_levels():
    before = sparse("hexapod-sparse").model_copy(update={"budget": 60.0, "levels": (180.0, 90.0)})
    found = with_budget(before, "sops=120")
    assert (found.budget, found.rounds) == (120, (360, 180, 120))
    same = {"budget": 60.0, "levels": (180.0, 90.0)}
    assert found.model_copy(update=same) == before
    derived = with_budget(before.model_copy(update={"levels": ()}), "sops=20")
    assert derived.rounds == (60, 40, 30, 24, 20)
    assert with_budget(sparse("hexapod-sparse-linear"), "sops=80").budget == 80
    assert with_budget(sparse("hexapod-small-mlp"), "macs=500").budget == 500


@pytest.mark.parametrize(
    ("recipe", "text", "message"),
    [
        ("hexapod-sparse", "macs=480", r"delta-snn policy are sops, .* --budget sops="),
        ("hexapod-small-linear", "sops=480", r"pruned-mlp policy are macs, .* --budget macs="),
        ("hexapod-sparse", "480", "--budget sops="),
        ("hexapod-sparse", "sops=", "--budget sops="),
        ("hexapod-sparse", "sops=many", "budget: .* number, .* got 'many'"),
        ("hexapod-sparse", "sops=-3", r"budget: .* greater than 0, got -3"),
        ("hexapod-sparse", "sops=inf", r"budget: .* finite number, got inf"),
        ("hexapod-sparse", "sops=1e308", r"--budget sops=1e308: levels.0: .* finite number"),
    ],
)
def test_a_wrong_budget_is_refused_in_one_line(recipe, text, message):
    with pytest.raises(ConfigError, match=message) as error:
        with_budget(sparse(recipe), text)
    assert "\n" not in str(error.value)


def test_other_recipes_have_no_budget(tmp_path):
    with pytest.raises(
        ConfigError, match="hexapod-sac has no budget of operations; hexapod-sparse"
    ):
        with_budget(resolve(SacConfig, "hexapod-sac"), "sops=480")
    with pytest.raises(ConfigError, match="smoke has no budget"):
        train("smoke", budget="sops=480", runs=tmp_path)
    assert not list(tmp_path.iterdir())
