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
    """Yield names and recipes of the tables of recipes.toml."""
    for entry in data["recipe"]:
        rows, columns = (
            data["tables"].get(entry.get(key), {"": {}}) for key in ("rows", "columns")
        )
        for (row, above), (column, beside) in (
            (each, other) for each in _split(rows) for other in columns.items()
        ):
            words, both = {"row": row, "column": column}, {**above, **beside}
            words |= {k: v.format(**words) for k, v in both.items() if k != "settings"}
            cells = dict(_split(entry.get("cells", {})))
            settings = merge(
                {},
                *(data["parts"][name] for name in entry.get("parts", ())),
                above.get("settings", {}),
                beside.get("settings", {}),
                entry.get("settings", {}),
                cells.get(row, {}).get(column, {}),
            )
            name, summary = (entry[key].format(**words) for key in ("name", "summary"))
            filled: Settings = _filled(settings, row)
            yield name, Recipe(entry["algorithm"], summary, filled, entry.get("any_env", False))


def _split(rows: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """Yield each row under each of its names."""
    for names, row in rows.items():
        yield from ((name, row) for name in names.split(","))


def _filled(value: Any, row: str) -> Any:  # noqa: ANN401
    """Return settings with the name of the row in place of {row}."""
    if isinstance(value, dict):
        return {key: _filled(each, row) for key, each in value.items()}
    return value.replace("{row}", row) if isinstance(value, str) else value


RECIPES: dict[str, Recipe] = dict(_recipes(read_toml(Path(__file__).with_suffix(".toml"))))
