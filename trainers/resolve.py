"""How a recipe, a TOML file and `--set` are combined into a configuration."""

import difflib
import json
import sys
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from spikedeploy.runtime.errors import ConfigError
from spikedeploy.trainers.config import C, RunConfig
from spikedeploy.trainers.recipe import merged
from spikedeploy.trainers.recipes import RECIPES

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib  # type: ignore[import-not-found, unused-ignore]

_RENAMED = {"hoist": "support_force"}  # settings of version 0.1, accepted under their old names


def resolve(
    model: type[C],
    recipe: str,
    *,
    file: str | Path | None = None,
    overrides: Iterable[str] = (),
    seed: int = 0,
) -> C:
    """Return the recipe's configuration, changed by the file and then by the overrides."""
    entry = RECIPES[known(recipe, RECIPES, "recipe")]
    defaults = model(algorithm=entry.algorithm, recipe=recipe, seed=seed).model_dump()
    if "policy" in entry.settings:
        del defaults["policy"]  # another kind of policy has other settings
    base = validated(model, merged(defaults, entry.settings), f"recipe {recipe}")
    if entry.any_env:
        base = _stretched(base, amended(base, file=file, overrides=overrides))
    return amended(base, file=file, overrides=overrides)


def amended(base: C, *, file: str | Path | None = None, overrides: Iterable[str] = ()) -> C:
    """Return a configuration changed by the file and then by the overrides."""
    settings = base.model_dump(mode="json")
    if file is not None:
        settings = _overlaid(settings, _renamed(_read_toml(file)), str(file))
    for text in overrides:
        settings = _overlaid(settings, _renamed(parse_override(text)), f"--set {text}")
    return validated(type(base), settings, f"recipe {base.recipe}")


def _stretched(base: C, asked: C) -> C:
    """Return the base with every schedule stretched to the length that is asked for."""
    settings = base.model_dump(mode="json")
    share = getattr(asked, "steps", 1) / settings.get("steps", 1)
    for value in settings.values():
        for end in ("begin", "finish"):
            if isinstance(value, dict) and end in value:
                value[end] = round(value[end] * share)
    return validated(type(base), settings, f"recipe {base.recipe}")


def differences(config: RunConfig) -> list[str]:
    """Return the overrides, as `--set` takes them, that turn the recipe into this configuration."""
    recipe = _flat(resolve(type(config), config.recipe, seed=config.seed).model_dump(mode="json"))
    found = _flat(config.model_dump(mode="json"))
    return [
        f"{key}={json.dumps(value)}" for key, value in found.items() if recipe.get(key) != value
    ]


def _flat(settings: Mapping[str, Any], path: str = "") -> dict[str, Any]:
    """Return nested settings as one level of dotted names."""
    result: dict[str, Any] = {}
    for key, value in settings.items():
        inner = isinstance(value, Mapping) and value
        result |= _flat(value, f"{path}{key}.") if inner else {path + key: value}
    return result


def known(name: str, names: Iterable[str], kind: str, remedy: str = "") -> str:
    """Return `name` if it is one of the names, else raise ConfigError with the closest ones.

    remedy: what else may have been meant
    """
    choices = sorted(names)
    if name in choices:
        return name
    near = difflib.get_close_matches(name, choices, n=3)
    hint = f"did you mean {' or '.join(near)}?" if near else f"known: {', '.join(choices)}"
    raise ConfigError(f"unknown {kind} '{name}': {hint}{remedy}")


def _read_toml(file: str | Path) -> dict[str, Any]:
    """Return the tables of a TOML file."""
    try:
        tables: dict[str, Any] = tomllib.loads(Path(file).read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigError(f"cannot read the configuration file {file}: {error}") from error
    except (ValueError, RecursionError) as error:
        raise ConfigError(f"{file} is not valid TOML: {error}") from error
    return tables


def parse_override(text: str) -> dict[str, Any]:
    """Return `a.b=value` as nested tables; a value that is not TOML is a string."""
    key, equals, value = text.partition("=")
    parts = key.strip().split(".")
    if not equals or not all(parts):
        raise ConfigError(f"--set takes key=value, as in --set policy.hidden=[64,64]; got '{text}'")
    try:
        parsed = tomllib.loads(f"value = {value}")["value"]
    except RecursionError:
        raise ConfigError(f"--set {key.strip()}: its value is nested too deeply") from None
    except ValueError:  # tomllib's own, and of numbers with thousands of digits
        parsed = value.strip()
    for part in reversed(parts):
        parsed = {part: parsed}
    nested: dict[str, Any] = parsed
    return nested


def _overlaid(
    settings: Mapping[str, Any], change: Mapping[str, Any], source: str, path: str = ""
) -> dict[str, Any]:
    """Return `settings` with a nested change applied; unknown keys raise ConfigError."""
    result = dict(settings)
    for key, value in change.items():
        name = path + key
        if path not in ("env.options.", "shaping."):  # checked by the environment itself
            kind = f"setting ({source}) {path}".rstrip()
            own = "" if path else f"; an option of the environment is env.options.{key}"
            known(key, settings, kind, own)
        old = settings.get(key)
        if isinstance(old, Mapping) and isinstance(value, Mapping):
            value = _overlaid(old, value, source, f"{name}.")
        result[key] = value
    return result


def validated(model: type[C], settings: Mapping[str, Any], source: str) -> C:
    """Return the settings as a model, or raise ConfigError that names every wrong one."""
    try:
        return model.model_validate(_renamed(settings))
    except ValidationError as error:
        faults = "; ".join(_fault(**fault) for fault in error.errors())
        raise ConfigError(f"{source}: {faults}") from error


def _renamed(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Return settings under their present names."""
    return {_RENAMED.get(key, key): value for key, value in settings.items()}


def _fault(loc: tuple[int | str, ...], msg: str, input: object, **_: object) -> str:
    """Return one of pydantic's errors as `a.b: what is wrong, got x`."""
    said = msg.removeprefix("Value error, ")
    # one of settings that do not go together says itself what it found
    return f"{'.'.join(map(str, loc))}: {said}, got {input!r}" if loc else said
