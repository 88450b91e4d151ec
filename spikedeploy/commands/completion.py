"""Completion at the tab key: environments, policies, runs, chips, recipes.

`spikedeploy --install-completion` puts it into the shell, which offers files where nothing here
begins so.
"""

from collections.abc import Iterable
from pathlib import Path

_RUNS = Path("runs")


def environments(incomplete: str) -> list[str]:
    """Short names of ours, and ids of gymnasium once one is begun."""
    import gymnasium

    from spikedeploy.envs import ENVS

    return _beginning(incomplete, (*ENVS, *(gymnasium.registry if incomplete else ())))


def policies(incomplete: str) -> list[str]:
    """Shipped policies, and runs."""
    from spikedeploy import zoo

    apart = (f"{zoo.FOR_CHIPS}/{file.parent.name}/{file.stem}" for file in zoo.for_chips())
    return _beginning(incomplete, (*zoo.names(), *apart, *run_names(incomplete)))


def run_names(incomplete: str) -> list[str]:
    """Runs under runs/, and the newest."""
    found = sorted(config.parent.name for config in _RUNS.glob("*/config.json"))
    return _beginning(incomplete, (*found, *(["last"] if found else ())))


def chips(incomplete: str) -> list[str]:
    """Chips, and float; after a comma the next."""
    from spikedeploy.runtime.chips import CHIPS

    earlier, comma, last = incomplete.rpartition(",")
    return [f"{earlier}{comma}{name}" for name in _beginning(last, (*CHIPS, "float"))]


def recipes(incomplete: str) -> list[str]:
    """Recipes of trainings."""
    from spikedeploy.trainers.recipes import RECIPES

    return _beginning(incomplete, RECIPES)


def trainings(incomplete: str) -> list[str]:
    """Recipes, and the environments of recipes for any."""
    return [*recipes(incomplete), *environments(incomplete)]


def _beginning(incomplete: str, names: Iterable[str]) -> list[str]:
    return [name for name in names if name.startswith(incomplete)]
