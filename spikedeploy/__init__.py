"""The command line and the experiments: compare, report, demo and the zoo of shipped policies."""

from importlib.util import find_spec
from pathlib import Path

SIBLINGS = ("envs", "runtime", "trainers", "exporters")


def stranger(name: str, home: Path = Path(__file__).parent.parent) -> str | None:
    """Where the package `name` comes from, when that is not from beside this one; else None."""
    spec = find_spec(name)
    if spec is None:
        return "nowhere"
    places = list(spec.submodule_search_locations or [spec.origin or "nowhere"])
    return None if (home / name).resolve() in [Path(p).resolve() for p in places] else places[0]


for _name in SIBLINGS:
    if _origin := stranger(_name):
        raise ImportError(
            f"spikedeploy needs its own package {_name!r}, but Python finds that name at "
            f"{_origin}; install spikedeploy in an environment of its own"
        )
