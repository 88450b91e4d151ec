"""Environments with options, as the command line asks for them."""

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import gymnasium

from spikedeploy import envs
from spikedeploy.envs.foreign import is_target
from spikedeploy.runtime.errors import ConfigError


def make_env(name: str, options: Mapping[str, Any], **more: Any) -> gymnasium.Env[Any, Any]:  # noqa: ANN401
    """The environment with this short name or id; unknown options are refused."""
    return envs.make(name, **options, **more)


def confirm(found: str, named: str | None, source: str) -> None:
    """Refuse module:Class that a file names, unless the user names it: its code would be run.

    A file in the folder of the package that it names belongs to that project, which is run.
    """
    if is_target(found) and found != named and not _is_project(found, source):
        raise ConfigError(
            f"{source} was made for {found}, whose code is not run because a file names it: name "
            f"it yourself, with --env {found} (in Python env=, the class too)"
        )


def _is_project(found: str, source: str) -> bool:
    package = Path.cwd() / found.partition(":")[0].replace(".", "/")
    return package.is_dir() and Path(source).resolve().is_relative_to(package.resolve())


def parse_options(
    settings: Iterable[str], disturb: Iterable[str] = (), success: str | None = None
) -> dict[str, Any]:
    """Options from texts such as `track=small_S`; values are JSON, or else plain text.

    `lidar.noise=5` sets one of a group of options.

    disturb, success  as envs.make takes them
    """
    options: dict[str, Any] = {}
    for text in settings:
        name, equals, value = text.partition("=")
        *groups, last = name.split(".")
        if not equals or not last or not all(groups):
            raise ConfigError(f"--set takes option=value, as in --set track=small_S; got {text!r}")
        place = options
        for group in groups:
            place = place.setdefault(group, {})
            if not isinstance(place, dict):
                raise ConfigError(f"--set {text}: {group!r} was given as a whole already")
        try:
            place[last] = json.loads(value)
        except ValueError:
            place[last] = value
    if success is not None:
        options["success"] = success
    disturbances = list(disturb)
    return {**options, "disturb": disturbances} if disturbances else options


def disturbed_by(options: Mapping[str, Any]) -> tuple[str, ...]:
    """The disturbances in the options of an environment."""
    return tuple(options.get("disturb", ()))
