"""Environments with options, as the command line asks for them."""

from collections.abc import Mapping
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
