"""Environments with options, as the command line asks for them."""

import json
import re
from collections.abc import Iterable, Mapping
from typing import Any

import gymnasium

import envs
from runtime.errors import ConfigError


def made(name: str, options: Mapping[str, Any], **more: Any) -> gymnasium.Env[Any, Any]:  # noqa: ANN401
    """The environment with this short name or id; options that it does not have are refused."""
    try:
        return envs.make(name, **options, **more)
    except TypeError as error:
        wrong = re.search(r"unexpected keyword argument '(\w+)'", str(error))
        if wrong is None:
            raise
        spec = envs.spec(name)
        raise ConfigError(
            f"{spec.short} has no option {wrong[1]!r}; the docstring of "
            f"{spec.target.replace(':', '.')} lists those that it has"
        ) from error


def parsed(settings: Iterable[str]) -> dict[str, Any]:
    """The options in texts such as `track=small_S`; values are JSON, or else plain text."""
    options = {}
    for text in settings:
        name, equals, value = text.partition("=")
        if not equals or not name:
            raise ConfigError(f"--set takes option=value, as in --set track=small_S; got {text!r}")
        options[name] = _value(value)
    return options


def _value(text: str) -> Any:  # noqa: ANN401
    try:
        return json.loads(text)
    except ValueError:
        return text
