"""Disturbances: what goes wrong in a world while a policy acts, at levels 1 to 3 or by a number.

`spikedeploy.envs.make(name, disturb=["noise:2", "payload=0.4"])` puts them on an environment, as
`--disturb` does. They are drawn per episode from its seed; the draws of the environment do not
change. Foreign environments have those of observations and commands. A
new kind is a table in disturbances.toml and a change of options or a wrapper here.

Observations of ours are scaled so that each is about +-1, so a number of noise or bias is in units
of the scale of each observation, such as 0.5 m/s for a walker's velocity and 0.6 rad for its joints
(envs.hexapod.env). The scale of other environments is measured: the standard deviation of each
number over 2,000 control steps of actions drawn uniformly, always the same ones, so that it is of
the environment and not of a policy, and all policies meet the same noise.
"""

from __future__ import annotations

import inspect
import json
import math
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, is_dataclass
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar
from zlib import crc32

import gymnasium
import numpy as np
from numpy.typing import NDArray

from spikedeploy.envs.foreign import AdaptedEnv, make_foreign
from spikedeploy.envs.rollout import draw_action
from spikedeploy.runtime.errors import EnvError
from spikedeploy.runtime.files import read_toml
from spikedeploy.runtime.requests import Request, Scale, parse_requests

if TYPE_CHECKING:
    from spikedeploy.envs import EnvSpec

Options = dict[str, Any]
Wrap = Callable[[gymnasium.Env[Any, Any], float], gymnasium.Env[Any, Any]]

HEXAPOD, KART = "hexapod", "kart"  # worlds: folders of envs
FOREIGN = "foreign"  # foreign environments


@dataclass(frozen=True)
class Kind:
    """A kind of disturbance; it changes options of an environment, or wraps it.

    meaning: what happens, in a clause
    unit: of its number
    levels: world -> numbers of levels 1, 2 and 3; worlds without it are left out
    bounds: (lowest, highest) number that may be given
    source: where the levels come from
    option: of the environment, which is changed; for each world, where they differ
    by: how, a key of _MOVES; an option within a group is set
    wrap: the environment with the disturbance, of (environment, number)
    """

    meaning: str
    unit: str
    levels: Mapping[str, tuple[float, float, float]]
    bounds: tuple[float, float]
    source: str
    option: str | Mapping[str, str] = ""
    by: str = ""
    wrap: Wrap | None = None


FloatArray = NDArray[np.float64]

_STREAM = 11  # keeps the draws apart from those of environments and policies with the same seed


class SeededWrapper(gymnasium.Wrapper[Any, Any, Any, Any]):
    """A wrapper with a generator of its own; a reset without a seed goes on with it.

    STREAM: name of the kind, which keeps its draws apart
    WHOLE: whether the number counts something
    """

    STREAM: ClassVar[str]
    WHOLE: ClassVar[bool] = False

    def __init__(self, env: gymnasium.Env[Any, Any], number: float) -> None:
        super().__init__(env)
        if self.WHOLE and number != int(number):
            raise EnvError(f"--disturb {self.STREAM}={number:g}: give a whole number")
        self.number = number
        self.rng = np.random.default_rng()

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Start an episode; `_begin` draws what is constant in it."""
        if seed is not None:
            self.rng = np.random.default_rng([seed, _STREAM, crc32(self.STREAM.encode())])
        observation, info = self.env.reset(seed=seed, options=options)
        return self._begin(observation), info

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:  # noqa: ANN401
        """A step in which commands or observations are disturbed."""
        observation, reward, terminated, truncated, info = self.env.step(self._command(action))
        return self._observe(observation), reward, terminated, truncated, info

    def _begin(self, observation: FloatArray) -> FloatArray:
        """The first observation as the policy sees it."""
        return observation

    def _command(self, action: Any) -> Any:  # noqa: ANN401
        """Return the action that reaches the environment."""
        return action

    def _observe(self, observation: FloatArray) -> FloatArray:
        """Return an observation as the policy sees it."""
        return observation


def columns(env: gymnasium.Env[Any, Any], *without: str) -> NDArray[np.intp]:
    """Places (k,) of what sensors measure in an observation, without some entries of it.

    Last command, gait phase and the command to follow are the controller's own: nothing that
    happens to sensors changes them. In a foreign environment every entry is measured.
    """
    entries: dict[str, slice] | None = getattr(env.unwrapped, "OBSERVATION", None)
    if entries is None:
        return np.arange((env.observation_space.shape or (0,))[0])
    places = [
        np.arange(place.start, place.stop)
        for name, place in entries.items()
        if name not in (*_OWN, *without)
    ]
    return np.concatenate(places)


_OWN = ("previous", "phase", "command")


_STEPS = 2_000  # [control steps]
_measured: dict[str, FloatArray] = {}  # by name and options, as every copy of a batch asks


def scale(env: gymnasium.Env[Any, Any]) -> FloatArray | float:
    """The scale (obs,) of a foreign environment; 1 of ours, which are scaled."""
    world = env.unwrapped
    if not isinstance(world, AdaptedEnv):
        return 1.0
    if world.one_hot:
        levels = (world.observation_space.shape or (0,))[0]
        raise EnvError(
            f"{world.name} observes one of {levels} levels, in which "
            "there is neither noise nor bias: take dropout or delay"
        )
    options = {key: value for key, value in world.given.items() if key != "success"}
    key = json.dumps([world.name, options], sort_keys=True, default=repr)
    if key not in _measured:
        _measured[key] = _spread(make_foreign(world.name, options))
    return _measured[key]


def _spread(env: gymnasium.Env[Any, Any]) -> FloatArray:
    """Standard deviation (obs,) under actions drawn uniformly."""
    rng, space, episode = np.random.default_rng(0), env.action_space, 0
    seen = [env.reset(seed=episode)[0]]
    while len(seen) < _STEPS:
        observation, _, terminated, truncated, _ = env.step(draw_action(space, rng))
        seen.append(observation)
        if terminated or truncated:
            episode += 1
            seen.append(env.reset(seed=episode)[0])
    env.close()
    spread: FloatArray = np.std(seen, axis=0)
    return spread


class _Sensors(SeededWrapper):
    """Base of disturbances of sensor readings, clipped to the range of each observation."""

    WITHOUT: ClassVar[tuple[str, ...]] = ("lidar",)

    def __init__(self, env: gymnasium.Env[Any, Any], number: float) -> None:
        super().__init__(env, number)
        self._places = columns(env, *self.WITHOUT)
        space: Any = env.observation_space
        self._low, self._high = space.low[self._places], space.high[self._places]

    def _observe(self, observation: FloatArray) -> FloatArray:
        seen: FloatArray = observation.copy()
        measured = self._measure(seen[self._places])
        seen[self._places] = np.minimum(np.maximum(measured, self._low), self._high)
        return seen

    def _measure(self, values: FloatArray) -> FloatArray:
        """Sensor readings (k,) of the true values (k,)."""
        raise NotImplementedError


class _Errors(_Sensors):
    """Sensor errors, in units of the scale of each observation."""

    WITHOUT = ("lidar", "contact")  # switches have no noise

    def __init__(self, env: gymnasium.Env[Any, Any], number: float) -> None:
        super().__init__(env, number)
        self._scale = scale(env)


class Noise(_Errors):
    """White Gaussian noise on every measurement, drawn in each control step."""

    STREAM = "noise"

    def _begin(self, observation: FloatArray) -> FloatArray:
        return self._observe(observation)

    def _measure(self, values: FloatArray) -> FloatArray:
        return values + self._scale * self.rng.normal(0.0, self.number, values.shape)


class Bias(_Errors):
    """A constant error of every measurement, drawn in each episode."""

    STREAM = "bias"

    def _begin(self, observation: FloatArray) -> FloatArray:
        self._bias = self._scale * self.rng.normal(0.0, self.number, self._places.shape)
        return self._observe(observation)

    def _measure(self, values: FloatArray) -> FloatArray:
        return values + self._bias


class Dropout(_Sensors):
    """Measurements that are missing in a control step: the last one that arrived is seen."""

    STREAM = "dropout"

    def __init__(self, env: gymnasium.Env[Any, Any], number: float) -> None:
        super().__init__(env, number)
        self._apart = not getattr(env.unwrapped, "one_hot", False)  # which is one measurement

    def _begin(self, observation: FloatArray) -> FloatArray:
        self._last = observation[self._places]
        return observation

    def _measure(self, values: FloatArray) -> FloatArray:
        lost = self.rng.random(values.shape if self._apart else ()) < self.number
        self._last = np.where(lost, self._last, values)
        return self._last


class LateSensors(SeededWrapper):
    """Sensor readings of some control steps ago; the first observation until then."""

    STREAM, WHOLE = "delay", True

    def _begin(self, observation: FloatArray) -> FloatArray:
        self._places, length = columns(self), int(self.number) + 1
        self._line = deque([observation[self._places]] * length, length)
        return observation

    def _observe(self, observation: FloatArray) -> FloatArray:
        seen: FloatArray = observation.copy()
        self._line.append(observation[self._places])
        seen[self._places] = self._line[0]
        return seen


class LateCommands(SeededWrapper):
    """Commands that take effect some control steps later; none before."""

    STREAM, WHOLE = "command-delay", True

    def _begin(self, observation: FloatArray) -> FloatArray:
        delay = int(self.number)
        self._line = deque([no_command(self.env)] * delay, delay + 1)
        return observation

    def _command(self, action: Any) -> Any:  # noqa: ANN401
        self._line.append(_copied(action))
        return self._line.popleft()


class LostCommands(SeededWrapper):
    """Commands that are lost: the last one that arrived is held."""

    STREAM = "command-loss"

    def _begin(self, observation: FloatArray) -> FloatArray:
        self._held = no_command(self.env)
        return observation

    def _command(self, action: Any) -> Any:  # noqa: ANN401
        if self.rng.random() >= self.number:
            self._held = _copied(action)
        return self._held


def _copied(action: Any) -> Any:  # noqa: ANN401
    return np.copy(action) if np.ndim(action) else action


def no_command(env: gymnasium.Env[Any, Any]) -> Any:  # noqa: ANN401
    """Return the neutral action: a zero residual of a walker, a kart's first action.

    Of other environments the middle of the bounds, or the first choice.
    """
    space = env.action_space
    return 0 if isinstance(space, gymnasium.spaces.Discrete) else np.zeros(space.shape or ())


class DeadJoint(SeededWrapper):
    """Servos without torque: only the friction of their gears is left."""

    STREAM, WHOLE = "dead-joint", True

    def _begin(self, observation: FloatArray) -> FloatArray:
        dead = self.rng.permutation(18)[: int(self.number)]
        walker: Any = self.unwrapped
        walker.weaken(dead.tolist(), 0.0)
        return observation


class DeadLeg(SeededWrapper):
    """The three servos of one leg lose power."""

    STREAM = "dead-leg"

    def _begin(self, observation: FloatArray) -> FloatArray:
        first = 3 * int(self.rng.integers(6))
        walker: Any = self.unwrapped
        walker.weaken([first, first + 1, first + 2], 1.0 - self.number)
        return observation


_MOVES: dict[str, Callable[[float, float], float]] = {  # of an option, or of both its ends
    "add": lambda end, number: end + number,
    "add-degrees": lambda end, number: end + math.radians(number),
    "multiply": lambda end, number: end * number,
    "reduce": lambda end, number: end * (1.0 - number),
}


def _changed(kind: Kind, number: float, options: Options, entry: EnvSpec) -> Options:
    """Return the options of an environment with a disturbance of this kind."""
    if not kind.option:
        return options
    option = kind.option if isinstance(kind.option, str) else kind.option[row(entry.world)]
    group, _, field = option.rpartition(".")
    if group:  # one number of several; the others stay as they are given
        given: Any = options.get(group) or {}
        before = asdict(given) if is_dataclass(given) and not isinstance(given, type) else given
        return {**options, group: {**before, field: number}}
    value: Any = options[option] if option in options else _default(entry, option)
    move = _MOVES[kind.by]
    if isinstance(value, (tuple, list)):
        return {**options, option: tuple(move(end, number) for end in value)}
    return {**options, option: move(value, number)}


_WRAPPERS: tuple[type[SeededWrapper], ...] = (
    Noise, Bias, Dropout, LateSensors, LateCommands, LostCommands, DeadJoint, DeadLeg,
)  # fmt: skip
_WRAPS = {wrapper.STREAM: wrapper for wrapper in _WRAPPERS}

DISTURBANCES: dict[str, Kind] = {
    name: Kind(**given, wrap=_WRAPS.get(name))
    for name, given in read_toml(Path(__file__).with_suffix(".toml")).items()
}


def kinds_of(world: str) -> dict[str, Kind]:
    """The kinds that a world has, by name."""
    return {name: kind for name, kind in DISTURBANCES.items() if row(world) in kind.levels}


def row(world: str) -> str:
    """Return the key of a world in Kind.levels: its folder, or FOREIGN."""
    return world if world in (HEXAPOD, KART) else FOREIGN


class Disturbance(Request):
    """A requested disturbance; its name is a key of DISTURBANCES."""

    @property
    def kind(self) -> Kind:
        """Its kind."""
        return DISTURBANCES[self.name]


def disturbances(texts: Sequence[str], world: str) -> list[Disturbance]:
    """Parse the requests `name:level` and `name=number`; those of level 0 are left out.

    EnvError names what the world has, where it does not have one of them.
    """
    if isinstance(texts, str):
        raise EnvError(f"disturb: {texts!r} is no list; write ['{texts}']")
    scales = {
        name: Scale(kind.levels[row(world)], kind.bounds, kind.unit)
        for name, kind in kinds_of(world).items()
    }
    try:
        found = parse_requests(texts, "--disturb", world, scales)
    except ValueError as error:
        raise EnvError(str(error)) from None
    return [Disturbance(each.name, each.number, each.text) for each in found]


class DisturbedEnv(gymnasium.Wrapper[Any, Any, Any, Any]):
    """An environment with its disturbances; `given` are the options that make it again."""

    def __init__(self, env: gymnasium.Env[Any, Any], given: Mapping[str, Any]) -> None:
        super().__init__(env)
        self.given = given


def make_disturbed(
    entry: EnvSpec,
    texts: Sequence[str],
    options: Options,
    make: Callable[[Options], gymnasium.Env[Any, Any]],
) -> gymnasium.Env[Any, Any]:
    """The environment that `make` builds of options, disturbed."""
    found = disturbances(texts, entry.world)
    changed = options
    for each in found:
        changed = _changed(each.kind, each.number, changed, entry)
    env = make(changed)
    given = env.given if isinstance(env, AdaptedEnv) else options
    for each in found:
        if each.kind.wrap is not None:
            env = each.kind.wrap(env, each.number)
    return DisturbedEnv(env, {**given, "disturb": [each.text for each in found]}) if found else env


def _default(entry: EnvSpec, option: str) -> Any:  # noqa: ANN401
    """Return the default of an option of the class or of its nearest base that has it."""
    module, _, name = entry.target.partition(":")
    for each in getattr(import_module(module), name).__mro__:
        parameter = inspect.signature(each.__init__).parameters.get(option)
        if parameter is not None:
            return parameter.default
    raise EnvError(f"{name} has no option {option!r}")
