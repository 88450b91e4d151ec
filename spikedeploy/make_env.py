"""Environments with options, as the command line asks for them."""

from collections.abc import Mapping
from typing import Any

import gymnasium

from spikedeploy import envs
from spikedeploy.envs.foreign import is_target
from spikedeploy.runtime.errors import ConfigError


def make_env(name: str, options: Mapping[str, Any], **more: Any) -> gymnasium.Env[Any, Any]:  # noqa: ANN401
    """The environment with this short name or id; unknown options are refused."""
    return envs.make(name, **options, **more)


def confirm(found: str, named: str | None, source: str) -> None:
    """Refuse module:Class that a file names, unless the user names it: its code would be run."""
    if is_target(found) and found != named:
        raise ConfigError(
            f"{source} was made for {found}, whose code is not run because a file names it: name "
            f"it yourself, with --env {found} (in Python env=, the class too)"
        )
