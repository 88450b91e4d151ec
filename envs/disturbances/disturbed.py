"""Requests such as `noise:2` or `payload=0.4`, and environments with what they ask for."""

from __future__ import annotations

import inspect
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import Any

import gymnasium

from spikedeploy.envs.disturbances import DISTURBANCES
from spikedeploy.envs.disturbances.kind import FOREIGN, HEXAPOD, KART, Kind, Options
from spikedeploy.envs.errors import EnvError
from spikedeploy.envs.foreign import make_foreign

LEVELS = (1, 2, 3)


def kind(name: str) -> Kind:
    """The kind of this name, imported now."""
    module, _, attribute = DISTURBANCES[name].partition(":")
    found: Kind = getattr(import_module(module), attribute)
    return found


def kinds_of(world: str) -> dict[str, Kind]:
    """The kinds that a world has, by name."""
    every = {name: kind(name) for name in DISTURBANCES}
    return {name: found for name, found in every.items() if row(world) in found.levels}


def row(world: str) -> str:
    """The key of a world in Kind.levels: its folder, or FOREIGN."""
    return world if world in (HEXAPOD, KART) else FOREIGN


@dataclass(frozen=True)
class Disturbance:
    """A disturbance as it was asked for.

    name    key of DISTURBANCES
    number  of its unit
    text    as the command line takes it
    """

    name: str
    number: float
    text: str

    @property
    def kind(self) -> Kind:
        """What it is."""
        return kind(self.name)


def disturbances(texts: Sequence[str], world: str) -> list[Disturbance]:
    """The requests `name:level` and `name=number`, read; those of level 0 are left out.

    EnvError names what the world has, where it does not have one of them.
    """
    if isinstance(texts, str):
        raise EnvError(f"disturb: {texts!r} is no list; write ['{texts}']")
    found = [_read(text, world) for text in texts]
    names = [each.name for each in found]
    if twice := [name for name in names if names.count(name) > 1]:
        raise EnvError(f"--disturb {twice[0]} is given twice: give each once")
    return [each for each in found if each.text.partition(":")[2] != "0"]


def _read(text: str, world: str) -> Disturbance:
    name, level, given = _parts(text)
    found = kinds_of(world)
    if name not in found:
        raise EnvError(f"--disturb {text}: {world} has no {name!r}; it has {', '.join(found)}")
    if level:
        numbers = (0.0, *found[name].levels[row(world)])
        if given not in map(str, range(len(numbers))):
            raise EnvError(
                f"--disturb {text}: {given!r} is no level from 0 to {LEVELS[-1]}; "
                f"a number is written {name}={given}"
            )
        return Disturbance(name, numbers[int(given)], text)
    return Disturbance(name, _number(text, given, found[name]), text)


def _parts(text: str) -> tuple[str, bool, str]:
    """Name, whether a level follows, and what follows."""
    name, colon, level = text.partition(":")
    if colon:
        return name, True, level
    name, equals, number = text.partition("=")
    if not equals:
        raise EnvError(f"--disturb takes name:level or name=number, as in noise:2; got {text!r}")
    return name, False, number


def _number(text: str, given: str, of: Kind) -> float:
    lowest, highest = of.bounds
    try:
        number = float(given)
    except ValueError:
        number = float("nan")
    if not lowest <= number <= highest:
        raise EnvError(
            f"--disturb {text}: {given!r} is not a number from {lowest:g} to {highest:g} "
            f"[{of.unit}]"
        )
    return number


class Disturbed(gymnasium.Wrapper[Any, Any, Any, Any]):
    """An environment with its disturbances; `given` are the options that make it again."""

    def __init__(self, env: gymnasium.Env[Any, Any], given: Mapping[str, Any]) -> None:
        super().__init__(env)
        self.given = given


def disturbed(
    id_: str, target: str, world: str, texts: Sequence[str], options: Mapping[str, Any]
) -> gymnasium.Env[Any, Any]:
    """The environment with this id and its options, disturbed.

    target  "module:class" of it
    world   folder of envs that it stands in
    """
    found = disturbances(texts, world)
    if not found:
        return gymnasium.make(id_, **options)
    changed: Options = dict(options)
    for each in found:
        if each.kind.change is not None:
            changed = each.kind.change(changed, each.number, lambda o: _default(target, o), world)
    return _wrapped(gymnasium.make(id_, **changed), found, options)


def disturbed_foreign(
    name: str, texts: Sequence[str], options: Mapping[str, Any], success: str | None = None
) -> gymnasium.Env[Any, Any]:
    """The environment of somebody else, disturbed in what is observed and commanded."""
    env = make_foreign(name, options, success)
    found = disturbances(texts, name)
    return _wrapped(env, found, env.given) if found else env


def _wrapped(
    env: gymnasium.Env[Any, Any], found: Sequence[Disturbance], options: Mapping[str, Any]
) -> Disturbed:
    for each in found:
        if each.kind.wrap is not None:
            env = each.kind.wrap(env, each.number)
    return Disturbed(env, {**options, "disturb": [each.text for each in found]})


def _default(target: str, option: str) -> Any:  # noqa: ANN401
    """Default of an option of the class, or of the class above that has it."""
    module, _, name = target.partition(":")
    for each in getattr(import_module(module), name).__mro__:
        parameter = inspect.signature(each.__init__).parameters.get(option)
        if parameter is not None:
            return parameter.default
    raise EnvError(f"{name} has no option {option!r}")
