"""A policy in C as a shared object: `lib<prefix>.so`, as `make lib` builds it of an export.

It is machine code and runs with the rights of whoever starts it, so it is loaded only after
`permit`, which a command calls where the user says so for this very file.
"""

import ctypes
import re
import shlex
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikedeploy.evaluation_setup import Setup
from spikedeploy.policies.registry import Candidate, Controller, Env, Floats
from spikedeploy.runtime.errors import ConfigError, ObservationError

_NAME = re.compile(r"lib([a-z][a-z0-9_]{0,30})\.so")
# of <prefix>_interface: version, observations, actions, actions to choose from
_VERSION, _FIELDS = 1, 4
_permitted: set[Path] = set()


def permit(path: Path) -> None:
    """Permit the loading of this file, as the user asked."""
    _permitted.add(path.resolve())


class NativeController(Controller):
    """A controller that calls C.

    path: path of the shared object.
    observed, actions, choices: numbers of an observation, numbers of an action, and actions to
        choose from, 0 where an action is numbers.
    """

    def __init__(self, path: Path) -> None:
        prefix = _prefix(path)
        try:
            self._library = ctypes.CDLL(str(path.resolve()))
            self._reset = getattr(self._library, f"{prefix}_reset")
            self._step = getattr(self._library, f"{prefix}_step")
            table = (ctypes.c_uint32 * _FIELDS).in_dll(self._library, f"{prefix}_interface")
        except (OSError, AttributeError, ValueError) as error:
            raise ConfigError(
                f"{path} is no policy in C: {error}. Build it with `make lib` in a folder that "
                "`spikedeploy export --to c` wrote."
            ) from error
        version, self.observed, self.actions, self.choices = list(table)
        if version != _VERSION:
            raise ConfigError(f"{path} has interface {version}; this spikedeploy has {_VERSION}")
        kind = ctypes.c_int32 if self.choices else ctypes.c_double
        self._action: ctypes.Array[Any] = (kind * self.actions)()

    @classmethod
    def describe(cls, path: Path) -> Candidate:
        """The candidate of a shared object that the user permits."""
        if path.resolve() not in _permitted:
            raise ConfigError(
                f"{path} is machine code, which would run with all your rights: if you built it "
                f"yourself, run it with `spikedeploy run {shlex.quote(str(path))} --native "
                "--env ENV`"
            )
        found = cls(path)
        return Candidate(
            path=str(path),
            name=_prefix(path),
            kind="control",
            format=".so",
            observed=found.observed,
            actions=found.choices or found.actions,
        )

    @classmethod
    def open(cls, candidate: Candidate, chip: str | None, env: Env, setup: Setup) -> Controller:
        """The shared object, loaded."""
        if setup.sampled:
            raise ConfigError("a policy in C gives its best action: leave --sampled out")
        return cls(Path(candidate.path))

    def reset(self, seed: int) -> None:
        """Forget every state."""
        self._reset()

    def act(self, observation: Floats) -> NDArray[Any]:
        """The action (act,), or () int where it is one of several."""
        row = np.ascontiguousarray(observation, np.float64)
        if row.shape != (self.observed,):
            raise ObservationError(f"the observation has shape {row.shape}, not {(self.observed,)}")
        if self._step(row.ctypes.data_as(ctypes.c_void_p), self._action):
            raise ObservationError("the observation holds a number that is not finite")
        found = np.array(self._action[: self.actions])
        return np.asarray(found[0]) if self.choices else found

    def replay(self, observations: Floats) -> NDArray[Any]:
        """Actions (S, act) or (S,) for the observations (S, obs) of an episode."""
        self.reset(0)
        return super().replay(observations)


def _prefix(path: Path) -> str:
    """Prefix of its names, by its own name."""
    if not (named := _NAME.fullmatch(path.name)):
        raise ConfigError(f"{path}: a policy in C is called lib<prefix>.so, as libpolicy.so")
    return named[1]
