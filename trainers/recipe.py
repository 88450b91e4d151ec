"""A recipe: what to train, as differences from the defaults of an algorithm's configuration."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

Settings = dict[str, Any]

KART_ENVS = ("kart-grid", "kart-gazebo", "kart-steer")


@dataclass(frozen=True)
class Recipe:
    """What to train, and how.

    algorithm: key of `trainers.ALGORITHMS`
    summary: one line
    settings: nested settings that differ from the algorithm's defaults
    any_env: whether the command line names the environment
    """

    algorithm: str
    summary: str
    settings: Mapping[str, Any]
    any_env: bool = False


def merged(settings: Mapping[str, Any], *changes: Mapping[str, Any]) -> Settings:
    """Return `settings` with nested changes applied in order."""
    result = dict(settings)
    for change in changes:
        for key, value in change.items():
            old = result.get(key)
            nested = isinstance(old, Mapping) and isinstance(value, Mapping)
            result[key] = merged(old, value) if nested else value  # type: ignore[arg-type]
    return result


def budget(recipe: Recipe) -> str:
    """Operations of a control step that a recipe ends with: `50 SOPs`; empty where it has none."""
    count = recipe.settings.get("budget")
    unit = "MACs" if recipe.settings.get("policy", {}).get("kind") == "pruned-mlp" else "SOPs"
    return "" if count is None else f"{count:,g} {unit}"
