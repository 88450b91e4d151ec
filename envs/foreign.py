"""Environments of other packages, adapted to policies: ids of gymnasium, or module:Class.

    observation  Box of any shape and bounds: its numbers in float64, unscaled, as policies have a
                 normaliser; Discrete: one-hot
    action       Box with finite bounds: from [-1, 1]; Discrete: from 0
    reward       one number, of an array or tensor of one element too
    info         the numbers in it, and success where it is known

An environment with an OBSERVATION (name of an entry -> its slice) is in these units already, and is
played as it stands; disturbances leave its entries `previous`, `phase` and `command` alone.

Other spaces, pictures, and actions without bounds are refused, and so is what is no number, and a
wrapper of gymnasium's that goes on measuring from episode to episode. Nothing is imported but the
module that a target names. The current folder is searched, after the installed packages, for
targets alone. The code of the environment runs in the user's process; what it prints goes to
stderr, as stdout is for results.
"""

from __future__ import annotations

import difflib
import importlib
import os
import re
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, redirect_stdout
from functools import partial
from pathlib import Path
from traceback import walk_tb
from typing import Any, TypeAlias

import gymnasium
import numpy as np
from gymnasium.envs.registration import EnvSpec as Registration
from gymnasium.spaces import Box, Discrete
from gymnasium.wrappers import NormalizeObservation, NormalizeReward
from numpy.typing import NDArray

from spikedeploy.envs import drawing
from spikedeploy.envs.event_camera_wrapper import EventCameraWrapper, control_period
from spikedeploy.envs.returned import (
    find_flag,
    is_unknown,
    numbers_in,
    read_flag,
    read_number,
    read_vector,
    show,
)
from spikedeploy.runtime.errors import EnvError

FloatArray: TypeAlias = NDArray[np.float64]
_TODAY = (
    "gymnasium's environments return (observation, info) from reset(seed=…, options=…), and "
    "(observation, reward, terminated, truncated, info) from step: change it to that"
)
# a wider span of actions has fewer steps of float32 in [-1, 1], 2^-24 each, than whole units
_WIDEST = 2.0**24
_MOST_CHOICES = 2**16  # of Discrete
_LONGEST = 100_000  # control steps of an episode: without a time limit it might never end
_SUCCESS = ("success", "is_success")
_FLAG = "success is True or False, or 0 or 1: give a flag, such as info[{!r}] = error < 0.1"


class AdaptedEnv(gymnasium.Env[FloatArray, Any]):
    """An environment of another package, adapted to policies.

    inner: as gymnasium made it
    name: as requested
    given: options that make it again
    one_hot: whether it observes one of several
    CONTROL_DT: time of a control step [s]; None where it is not known
    remark: on values of success that are neither true nor false; "" without any
    """

    def __init__(
        self,
        inner: gymnasium.Env[Any, Any],
        name: str,
        given: Mapping[str, Any],
        success: str | None = None,
    ) -> None:
        self.inner, self.name, self.given = inner, name, given
        self.one_hot = isinstance(inner.observation_space, Discrete)
        self.metadata, self.render_mode = inner.metadata, inner.render_mode
        self.spec = Registration("Adapted-v0")
        self.spec.id = name  # not above: gymnasium parses names, not targets
        space, self._from_inner = _observation_map(name, inner.observation_space)
        self.observation_space: gymnasium.Space[Any] = space
        self.action_space, self._to_inner = _action_map(name, inner.action_space)
        self._bounds = _bounds(inner)
        self.CONTROL_DT = control_period(inner)
        self._key, self.remark = success, ""
        self._threshold = inner.spec.reward_threshold if inner.spec else None
        self._total, self._steps = 0.0, 0

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[FloatArray, dict[str, Any]]:
        """Start an episode."""
        self._total, self._steps = 0.0, 0
        observation, info = self._ask("reset", 2, seed=seed, options=options)
        return self._seen(observation), numbers_in(info)

    def step(self, action: Any) -> tuple[FloatArray, float, bool, bool, dict[str, Any]]:  # noqa: ANN401
        """Take an action (act,) in [-1, 1], or an index from 0."""
        found, gain, terminated, truncated, info = self._ask("step", 5, self._to_inner(action))
        self._steps += 1
        of = f"{self.name}: {{}} of step {self._steps}".format
        reward = read_number(of("reward"), gain)
        ends = read_flag(of("terminated"), terminated), read_flag(of("truncated"), truncated)
        self._total, over = self._total + reward, any(ends)
        if self._steps >= _LONGEST and not over:
            raise EnvError(
                f"{self.name}: an episode did not end in {_LONGEST:,} steps: give it a time "
                "limit with the option max_episode_steps=N"
            )
        return self._seen(found), reward, *ends, self._with_success(info, over)

    def render(self) -> Any:  # noqa: ANN401
        """The environment's picture; EnvError where its renderer is not available."""
        if hasattr(self.inner.unwrapped, "mujoco_renderer"):
            drawing.check_variable()
        try:
            with contained(self.name, "render()"):
                return self.inner.render()
        except Exception as error:
            if _is_of_renderer(error):
                raise drawing.explain(error) from error
            raise

    def close(self) -> None:
        """Close the environment."""
        with contained(self.name, "close()"):
            self.inner.close()

    def _ask(self, method: str, values: int, *given: Any, **options: Any) -> tuple[Any, ...]:  # noqa: ANN401
        """Return the values of `reset` or `step`; EnvError where they are of gym before 0.26."""
        doing = "reset()" if method == "reset" else f"step {self._steps + 1}"
        try:
            with contained(self.name, doing):
                found = getattr(self.inner, method)(*given, **options)
        except (TypeError, ValueError) as error:
            if not _is_of_old_api(error):
                raise
            raise EnvError(f"{self.name}: {method}: {error}; {_TODAY}") from error
        several = isinstance(found, tuple | list)
        if not several or len(found) != values:
            what = f"{len(found)} values" if several else f"a {type(found).__name__}"
            raise EnvError(f"{self.name}: {method} returns {what}; {_TODAY}")
        *rest, info = found
        if not isinstance(info, Mapping | None):
            raise EnvError(f"{self.name}: {method}: info is {show(info)}, no dictionary; {_TODAY}")
        if _bounds(self.inner) != self._bounds:  # actions would be scaled by those of before
            raise EnvError(
                f"{self.name}: its spaces change in {doing}, and policies have one of each: make "
                "it with the widest"
            )
        return *rest, info or {}

    def _seen(self, observation: Any) -> FloatArray:  # noqa: ANN401
        return self._from_inner(f"{self.name}: observation of step {self._steps}", observation)

    def _with_success(self, info: Mapping[str, Any], over: bool) -> dict[str, Any]:
        """Return the numbers of an info, with success so far by the named key or the threshold.

        Else `success` is the environment's own; `is_success` is the word of gymnasium-robotics and
        Stable-Baselines3 for it, and stands there as `success` alone.
        """
        found = numbers_in(info)
        if self._key is not None:
            return {**found, "success": self._named_success(self._key, info, over)}
        if self._threshold is not None:
            return {**found, "success": self._total >= self._threshold}
        found = {key: value for key, value in found.items() if key not in _SUCCESS}
        for word in _SUCCESS:
            if (flag := find_flag(info.get(word))) is not None:
                return {**found, "success": flag}
            if not is_unknown(info.get(word)) and not self.remark:
                self.remark = (
                    f"{self.name}: {word} in the info of step {self._steps} is {show(info[word])}, "
                    f"so that success is not known: {_FLAG.format(word)}"
                )
        return found

    def _named_success(self, key: str, info: Mapping[str, Any], over: bool) -> bool:
        """Return the flag of an info; at the last step it must be there."""
        flag, where = find_flag(info.get(key)), f"{self.name}: --success {key}: the info"
        if over and key not in info:
            raise EnvError(
                f"{where} of the last step has no such key; it has "
                f"{', '.join(map(str, info)) or 'none'}"
            )
        if flag is None and (over or not is_unknown(info.get(key))):
            raise EnvError(
                f"{where} of step {self._steps} has {show(info.get(key))} there, neither true nor "
                f"false; {_FLAG.format(key)}"
            )
        return bool(flag)


@contextmanager
def contained(name: str, doing: str) -> Iterator[None]:
    """Run foreign code in this block: prints go to stderr, a sys.exit becomes an EnvError."""
    try:
        with redirect_stdout(sys.stderr):
            yield
    except SystemExit as stop:
        *_, (frame, _) = walk_tb(stop.__traceback__)
        if str(frame.f_globals.get("__name__")).startswith("spikedeploy."):
            raise  # our own end of a worker, on a signal
        raise EnvError(
            f"{name} ended the process in {doing}, with sys.exit or a function that calls it: take "
            "that out"
        ) from stop


def _bounds(world: gymnasium.Env[Any, Any]) -> list[tuple[Any, ...]]:
    """Return copies of what policies know of its spaces: shapes and bounds, or choices."""
    return [
        (each.dtype, each.shape, each.low.tobytes(), each.high.tobytes())
        if isinstance(each, Box)
        else (type(each), getattr(each, "start", None), getattr(each, "n", None))
        for each in (world.observation_space, world.action_space)
    ]


def _is_of_renderer(error: Exception) -> bool:
    """True where MuJoCo's or pygame's way to draw failed, and not the environment's own code."""
    *_, (frame, _) = walk_tb(error.__traceback__)
    at = str(frame.f_globals.get("__name__"))
    kinds = ("mujoco", "gymnasium.envs.mujoco.mujoco_rendering", "OpenGL", "glfw")
    return at.startswith(kinds) or type(error).__module__.startswith("pygame")


def _is_of_old_api(error: TypeError | ValueError) -> bool:
    """Return whether gymnasium's wrappers, or we, found other values or options than today's."""
    *_, (frame, _) = walk_tb(error.__traceback__)
    caller = Path(frame.f_code.co_filename)
    ours = caller.is_relative_to(Path(gymnasium.__file__).parent) or caller == Path(__file__)
    return ours and re.search("values to unpack|unexpected keyword", str(error)) is not None


def _observation_map(
    name: str, space: gymnasium.Space[Any]
) -> tuple[Box, Callable[[str, Any], FloatArray]]:
    """Return the space of observations (obs,), and the map of a named value into it."""
    if isinstance(space, Discrete):
        _check_choices(name, "observes", space)
        return Box(0.0, 1.0, (int(space.n),), np.float64), partial(_one_hot, space)
    if not isinstance(space, Box):
        raise EnvError(
            f"{name} observes a {type(space).__name__}, and policies observe one vector: make it "
            "with gymnasium.wrappers.FlattenObservation in a function of yours, and name that as "
            "module:function"
        )
    if space.dtype == np.uint8 and len(space.shape) > 1:
        raise EnvError(
            f"{name} observes pictures {space.shape}, and policies observe one vector of numbers: "
            "make it with a gymnasium.ObservationWrapper that measures what matters in them"
        )
    shape, size = space.shape, int(np.prod(space.shape))
    if not size:
        raise EnvError(f"{name} observes nothing: its Box has the shape {shape}. Give it numbers")
    return Box(-np.inf, np.inf, (size,), np.float64), partial(read_vector, shape=shape)


def _one_hot(space: Discrete, what: str, value: object) -> FloatArray:
    """Return a choice among n levels as a one-hot vector (n,)."""
    place, count = read_number(what, value) - int(space.start), int(space.n)
    if place % 1 or not 0 <= place < count:
        last = int(space.start) + count - 1
        raise EnvError(f"{what} is {show(value)}, none of {int(space.start)} to {last}")
    row: FloatArray = np.zeros(count)
    row[int(place)] = 1.0
    return row


def _check_choices(name: str, does: str, space: Discrete) -> None:
    if space.n > _MOST_CHOICES:
        raise EnvError(
            f"{name} {does} one of {int(space.n):,}, and policies have a number for each: at most "
            f"{_MOST_CHOICES:,}. Make it with a Box"
        )


def _action_map(
    name: str, space: gymnasium.Space[Any]
) -> tuple[Box | Discrete, Callable[[Any], Any]]:
    """The space of actions, (act,) in [-1, 1] or an index from 0, and the map out of it."""
    if isinstance(space, Discrete):
        _check_choices(name, "takes", space)
        start = int(space.start)
        return Discrete(int(space.n)), lambda action: int(action) + start
    if not isinstance(space, Box):
        raise EnvError(
            f"{name} takes actions of a {type(space).__name__}, and policies put out one vector or "
            "one choice: make it with a gymnasium.ActionWrapper whose action_space is a Box or "
            "Discrete, in a function of yours, and name that as module:function"
        )
    low, high = np.float64(space.low).reshape(-1), np.float64(space.high).reshape(-1)
    with np.errstate(over="ignore"):
        unbounded = ~(high - low <= _WIDEST)
    if unbounded.any():
        k = int(unbounded.argmax())
        raise EnvError(
            f"{name}: actions {np.flatnonzero(unbounded).tolist()} have no bounds that [-1, 1] "
            f"could be scaled to: they are from {low[k]:g} to {high[k]:g}, and with a span of over "
            f"2^24 = {_WIDEST:,.0f} one unit is less than a step of float32. Make it with an "
            "action_space whose bounds are those of sensible actions, in units that fit"
        )
    return Box(-1.0, 1.0, low.shape, np.float64), _scaling(space, low, high)


def _scaling(space: Box, low: FloatArray, high: FloatArray) -> Callable[[Any], NDArray[Any]]:
    """The map from [-1, 1] (act,) to a box, in its shape and type."""
    whole = np.issubdtype(space.dtype, np.integer)

    def scale(action: Any) -> NDArray[Any]:  # noqa: ANN401
        # a = low + (x + 1) / 2 (high - low)
        share = (np.clip(np.asarray(action, np.float64), -1.0, 1.0) + 1.0) / 2.0
        value = np.clip(low + share * (high - low), low, high)  # sums are rounded
        return (np.rint(value) if whole else value).astype(space.dtype).reshape(space.shape)

    return scale


_TARGET = re.compile(r"([A-Za-z_][\w.]*):([\w./-]+)")  # my_package.my_module:MyEnv
_ID = re.compile(r".+-v\d+")


def is_target(name: str) -> bool:
    """Return True if a name is module:Class or module:Registered-v0, with its module to import."""
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


def make_foreign(
    name: str, options: Mapping[str, Any], success: str | None = None
) -> gymnasium.Env[Any, Any]:
    """Make the environment for policies: adapted, unless it has an OBSERVATION as ours have.

    name: registered id, module:Class, module:function or module:Registered-v0
    options: of its constructor, and of gymnasium.make, such as max_episode_steps; and event_camera,
        to be seen by one: True, or options of EventCameraWrapper but record
    success: key of the step infos that says success; None for the registered reward threshold
    """
    given = {key: value for key, value in options.items() if (key, value) != ("render_mode", None)}
    made = {key: value for key, value in given.items() if key != "event_camera"}
    if camera := given.get("event_camera"):
        made["render_mode"] = "rgb_array"
    try:
        registered = _registration(name)
        with contained(name, "its making"):
            world = gymnasium.make(registered, disable_env_checker=True, **made)
    except TypeError as error:
        raise _explain(name, error) from error
    _check_wrappers(name, world)
    if camera:
        with contained(name, "render()"):
            world = _seen_by_events(world, camera)
    if hasattr(world.unwrapped, "OBSERVATION") and not camera:
        return _as_ours(world, name, success)
    shown = given if success is None else {**given, "success": success}
    return AdaptedEnv(world, name, shown, success)


def _as_ours(
    world: gymnasium.Env[Any, Any], name: str, success: str | None
) -> gymnasium.Env[Any, Any]:
    """The environment as it stands; its OBSERVATION says that it is in the units of policies."""
    observed, action = world.observation_space, world.action_space
    fits = isinstance(observed, Box) and observed.dtype == np.float64 and len(observed.shape) == 1
    if isinstance(action, Box):
        fits &= len(action.shape) == 1 and bool((action.low == -1).all() & (action.high == 1).all())
    else:
        fits &= isinstance(action, Discrete) and action.start == 0
    if not fits:
        raise EnvError(
            f"{name} has an OBSERVATION and observes {observed}, acts in {action}: with it an "
            "environment observes a vector of float64, and takes actions in [-1, 1] or from 0"
        )
    if success is not None:
        raise EnvError(f"{name} defines success itself: leave --success out")
    return world


def _check_wrappers(name: str, world: gymnasium.Env[Any, Any]) -> None:
    """Refuse gymnasium's wrappers that go on measuring from episode to episode."""
    remedies: dict[type[Any], str] = {
        NormalizeObservation: "policies measure mean and deviation themselves, into the file",
        NormalizeReward: "returns are told as the environment gives them",
    }
    layer: Any = world
    while isinstance(layer, gymnasium.Wrapper):
        for kind, remedy in remedies.items():
            if isinstance(layer, kind) and layer.update_running_mean:
                raise EnvError(
                    f"{name}: gymnasium's {kind.__name__} goes on measuring from episode to "
                    "episode, so that an episode depends on those that its process played before. "
                    f"Leave it out: {remedy}. Or freeze it, once it has measured, in the function "
                    "that makes the environment: wrapped.update_running_mean = False"
                )
        layer = layer.env


def _seen_by_events(world: gymnasium.Env[Any, Any], camera: object) -> EventCameraWrapper:
    """The environment with the event camera that an option asks for."""
    known = ("size", "parameters", "frames", "dt")
    options = {} if camera is True else camera
    if not isinstance(options, Mapping) or not set(options) <= set(known):
        raise EnvError(
            f"option event_camera: {camera!r} is neither true nor options of it: {', '.join(known)}"
        )
    return EventCameraWrapper(world, **options)


def check_target(name: str) -> None:
    """Import the module of a target; EnvError where it lacks the named object."""
    _registration(name)


def _registration(name: str) -> str | Registration:
    """Return the argument of gymnasium.make; the module of a target is imported here."""
    found = _TARGET.fullmatch(name)
    if found is None:
        return name
    module = import_target(name, found[1])
    if _ID.fullmatch(found[2]):
        if found[2] not in gymnasium.registry:
            raise EnvError(f"{name}: {found[1]} was imported and registers no {found[2]}")
        return found[2]
    return Registration(id=name.replace("/", "."), entry_point=_maker(name, module, found[2]))


def import_target(
    name: str, module: str, form: str = "ENV is module:Class, or module:Registered-v0"
) -> Any:  # noqa: ANN401
    """The module that a target names, from the current folder too; `form` is what targets are."""
    here = os.getcwd()
    if here not in sys.path:
        sys.path.append(here)
    try:
        with contained(name, f"the import of {module}"):
            return importlib.import_module(module)
    except ModuleNotFoundError as error:
        if not f"{module}.".startswith(f"{error.name}."):
            raise EnvError(f"{name}: importing {module} needs {error.name}: install it") from error
        hint = f"; leave .py out: {name.replace('.py:', ':')}" if ".py:" in name else ""
        raise EnvError(
            f"{name}: there is no module {module}, neither installed nor in {here}{hint}; {form}"
        ) from error


def attribute(name: str, module: Any, within: str) -> Any:  # noqa: ANN401
    """Return the object that the target `name` means in its module."""
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


def _explain(name: str, error: TypeError) -> Exception:
    """Return an error about the options; the error itself if it is a fault of the environment."""
    text = str(error)
    if wrong := re.search(r"unexpected keyword argument '([^']+)'", text):
        return EnvError(f"{name} has no option {wrong[1]!r}: its constructor does not take it")
    if lacks := re.search(r"missing \d+ required .*arguments?: (.+?)(?: was raised|$)", text):
        return EnvError(f"{name} needs {lacks[1]}: give each with --set OPTION=VALUE")
    if "must inherit from the gymnasium.Env" in text:
        return EnvError(
            f"{name} makes no gymnasium.Env: give one environment, and not several in a vector, "
            "as copies are made here"
        )
    return error
