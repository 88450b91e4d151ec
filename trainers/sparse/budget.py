"""Budgets as the command line takes them: sops=480 of a spiking policy, macs=500 of a float one."""

from spikedeploy.runtime.errors import ConfigError
from spikedeploy.trainers.config import C
from spikedeploy.trainers.recipes import RECIPES
from spikedeploy.trainers.resolve import amended, validated
from spikedeploy.trainers.sparse.config import SparseConfig

# what the operations of each kind of policy are called
_UNITS = {"delta-snn": "sops", "pruned-mlp": "macs"}


def with_budget(config: C, text: str) -> C:
    """Return a configuration with a budget [operations of a control step], such as "sops=480".

    Levels that the recipe names keep their ratio to the budget.
    """
    if not isinstance(config, SparseConfig):
        some = [name for name, recipe in RECIPES.items() if recipe.algorithm == "sparse"][:3]
        raise ConfigError(
            f"--budget {text}: recipe {config.recipe} has no budget of operations; "
            f"{', '.join(some)} and other recipes of the algorithm sparse have"
        )
    unit, _, number = text.partition("=")
    expected = _UNITS.get(config.policy.kind, "sops")
    if unit != expected or not number:
        raise ConfigError(
            f"--budget {text}: operations of a {config.policy.kind} policy are {expected}, so that "
            f"recipe {config.recipe} takes them as in --budget {expected}={config.budget:g}"
        )
    found = amended(config, overrides=[f"budget={number}"])
    ratio = found.budget / config.budget
    levels = [level * ratio for level in config.levels]
    return validated(type(found), found.model_dump() | {"levels": levels}, f"--budget {text}")
