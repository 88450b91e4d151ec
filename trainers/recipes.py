"""Recipes: what to train, as differences from an algorithm's defaults; tables in recipes.toml."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from spikedeploy.runtime.files import read_toml

Settings = dict[str, Any]


@dataclass(frozen=True)
class Recipe:
    """Settings of a training.

    algorithm: key of `trainers.ALGORITHMS`
    summary: one line
    settings: nested settings that differ from the algorithm's defaults
    any_env: whether the command line names the environment
    """

    algorithm: str
    summary: str
    settings: Mapping[str, Any]
    any_env: bool = False


def merge(settings: Mapping[str, Any], *changes: Mapping[str, Any]) -> Settings:
    """Return `settings` with nested changes applied in order."""
    result = dict(settings)
    for change in changes:
        for key, value in change.items():
            old = result.get(key)
            nested = isinstance(old, Mapping) and isinstance(value, Mapping)
            result[key] = merge(old, value) if nested else value  # type: ignore[arg-type]
    return result


def budget(recipe: Recipe) -> str:
    """Operations of a control step that a recipe ends with: `50 SOPs`; empty where it has none."""
    count = recipe.settings.get("budget")
    kind = recipe.settings.get("policy", {}).get("kind", "")
    unit = "MACs" if kind.startswith("pruned") else "SOPs"
    return "" if count is None else f"{count:,g} {unit}"


def _recipes(data: Mapping[str, Any]) -> Iterator[tuple[str, Recipe]]:
    """Yield names and recipes of recipes.toml."""
    for entry in data["recipe"]:
        parts = (data["parts"][name] for name in entry.get("parts", ()))
        whole = {**entry, "settings": merge({}, *parts, entry.get("settings", {}))}
        for env in entry.get("envs", [""]):
            named = _named(whole, env)
            more = named.get("any_env", False)
            yield (
                named["name"],
                Recipe(named["algorithm"], named["summary"], named["settings"], more),
            )


def _named(value: Any, env: str) -> Any:  # noqa: ANN401
    """Return a recipe with the name of an environment in place of {env}."""
    if isinstance(value, dict):
        return {key: _named(each, env) for key, each in value.items()}
    return value.replace("{env}", env) if isinstance(value, str) else value


RECIPES: dict[str, Recipe] = dict(_recipes(read_toml(Path(__file__).with_suffix(".toml"))))
