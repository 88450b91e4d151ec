"""Completion at the tab key: environments, policies, chips, recipes.

`spikedeploy --install-completion` puts it into the shell; where a list is empty the shell offers
files itself.
"""

from collections.abc import Iterable
from pathlib import Path

from spikedeploy.runtime.files import suffix

_RUNS = Path("runs")


def environments(incomplete: str) -> list[str]:
    """Short names of ours, and ids of gymnasium once one is begun."""
    import gymnasium

    from spikedeploy.envs import ENVS

    return _beginning(incomplete, (*ENVS, *(gymnasium.registry if incomplete else ())))


def policies(incomplete: str) -> list[str]:
    """Shipped policies and files, folder by folder; and runs by name."""
    from spikedeploy import zoo

    apart = (f"{zoo.FOR_CHIPS}/{file.parent.name}/{file.stem}" for file in zoo.for_chips())
    shipped = [*zoo.names(), *apart, *run_names(incomplete)]
    return _one_level(incomplete, shipped, zoo.SUFFIXES)


def networks(incomplete: str) -> list[str]:
    """Files of networks, folder by folder."""
    return _one_level(incomplete, (), (".nir",))


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


def _one_level(incomplete: str, names: Iterable[str], suffixes: tuple[str, ...]) -> list[str]:
    """Names and files that begin so, each to its next slash; one folder alone is opened."""
    folder, slash, start = incomplete.rpartition("/")
    before = len(folder + slash)
    found = dict.fromkeys(
        name[:before] + head + next_slash
        for name in _beginning(incomplete, names)
        for head, next_slash, _ in [name[before:].partition("/")]
    )
    try:
        here = sorted(Path(folder or slash or ".").iterdir())
    except OSError:
        here = []
    for path in here:
        hidden = path.name.startswith(".") and not start
        # the shell itself quotes names with spaces
        if path.name.startswith(start) and not hidden and not any(map(str.isspace, path.name)):
            if path.is_dir():
                found[f"{folder}{slash}{path.name}/"] = None
            elif suffix(path) in suffixes:
                found[f"{folder}{slash}{path.name}"] = None
    only = next(iter(found)) if len(found) == 1 else ""
    return _one_level(only, names, suffixes) if only.endswith("/") else list(found)
