"""Environments of other people: ids of gymnasium's registry, and targets such as module:Class.

Nothing is imported but the module that a target names. The current folder is searched, after the
installed packages, for targets alone. The code of the environment runs in the user's process.
"""

from __future__ import annotations

import difflib
import importlib
import os
import re
import sys
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import gymnasium
from gymnasium.envs.registration import EnvSpec as Registration

from spikedeploy.envs.adapted import AdaptedEnv
from spikedeploy.envs.errors import EnvError

_TARGET = re.compile(r"([A-Za-z_][\w.]*):([\w./-]+)")  # my_package.my_module:MyEnv
_ID = re.compile(r".+-v\d+")


def is_target(name: str) -> bool:
    """Whether a name is module:Class or module:Registered-v0, whose module it is to import."""
    return _TARGET.fullmatch(name) is not None


def entry_point(name: str) -> str | None:
    """The "module:class" of a registered name or target, else None; nothing is imported."""
    if is_target(name):
        return name
    if name not in gymnasium.registry:
        return None
    entry = gymnasium.registry[name].entry_point
    if entry is None or isinstance(entry, str):
        return entry or name
    return f"{entry.__module__}:{getattr(entry, '__qualname__', type(entry).__qualname__)}"


def nearest(name: str, ours: Iterable[str]) -> str | None:
    """The name most like this one, of ours and of gymnasium's registry, whatever its case."""
    known = {each.lower(): each for each in (*gymnasium.registry, *ours)}
    close = difflib.get_close_matches(name.lower(), known, n=1)
    return known[close[0]] if close else None


def make_foreign(name: str, options: Mapping[str, Any], success: str | None = None) -> AdaptedEnv:
    """The environment as policies expect it.

    name     registered id, module:Class, module:function or module:Registered-v0
    options  of its constructor, and of gymnasium.make, such as max_episode_steps
    success  key of the step infos that says success; None for the registered reward threshold
    """
    given = {key: value for key, value in options.items() if (key, value) != ("render_mode", None)}
    try:
        world = gymnasium.make(_registration(name), disable_env_checker=True, **given)
    except TypeError as error:
        raise _said(name, error) from error
    shown = given if success is None else {**given, "success": success}
    return AdaptedEnv(world, name, shown, success)


def check_target(name: str) -> None:
    """Import the module of a target; EnvError where it has not what the target names."""
    _registration(name)


def _registration(name: str) -> str | Registration:
    """What gymnasium.make takes; the module of a target is imported here."""
    found = _TARGET.fullmatch(name)
    if found is None:
        return name
    module = imported(name, found[1])
    if _ID.fullmatch(found[2]):
        if found[2] not in gymnasium.registry:
            raise EnvError(f"{name}: {found[1]} was imported and registers no {found[2]}")
        return found[2]
    return Registration(id=name.replace("/", "."), entry_point=_maker(name, module, found[2]))


def imported(
    name: str, module: str, form: str = "ENV is module:Class, or module:Registered-v0"
) -> Any:  # noqa: ANN401
    """The module that a target names, from the current folder too; `form` is what targets are."""
    here = os.getcwd()
    if here not in sys.path:
        sys.path.append(here)
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as error:
        if not f"{module}.".startswith(f"{error.name}."):
            raise EnvError(f"{name}: importing {module} needs {error.name}: install it") from error
        hint = f"; leave .py out: {name.replace('.py:', ':')}" if ".py:" in name else ""
        raise EnvError(
            f"{name}: there is no module {module}, neither installed nor in {here}{hint}; {form}"
        ) from error


def attribute(name: str, module: Any, within: str) -> Any:  # noqa: ANN401
    """What the target `name` means in its module."""
    found = getattr(module, within, None)
    if found is None:
        close = difflib.get_close_matches(within, dir(module), n=1)
        hint = f"; did you mean {close[0]!r}?" if close else ""
        raise EnvError(f"{name}: {module.__name__} ({module.__file__}) has no {within!r}{hint}")
    return found


def _maker(name: str, module: Any, within: str) -> Callable[..., Any]:  # noqa: ANN401
    found = attribute(name, module, within)
    if not callable(found) or (isinstance(found, type) and not issubclass(found, gymnasium.Env)):
        raise EnvError(f"{name}: {within} is no gymnasium.Env, nor a function that makes one")
    return found  # type: ignore[no-any-return]


def _said(name: str, error: TypeError) -> Exception:
    """What is wrong with the options; the error itself where it is a fault of the environment."""
    text = str(error)
    if wrong := re.search(r"unexpected keyword argument '([^']+)'", text):
        return EnvError(f"{name} has no option {wrong[1]!r}: its constructor does not take it")
    if lacks := re.search(r"missing \d+ required .*arguments?: (.+?)(?: was raised|$)", text):
        return EnvError(f"{name} needs {lacks[1]}: give each with --set OPTION=VALUE")
    if "must inherit from the gymnasium.Env" in text:
        return EnvError(f"{name} makes no gymnasium.Env")
    return error
