"""What a policy is before and after it is loaded, and what the module of a format must have."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Protocol, TypeAlias

from spikedeploy.runtime.chips.quantisation import PLAIN, Quantisation
from spikedeploy.runtime.emulator.backend import BackendName
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.faults import NONE, Faults

if TYPE_CHECKING:
    import gymnasium
    import numpy as np
    from numpy.typing import NDArray

    from spikedeploy.envs.rollout import Rollout
    from spikedeploy.policies.costs import Costs

    Floats: TypeAlias = NDArray[np.float64]

BASELINES = ("gait", "random")  # kinds without a trained policy: the zero of a normalised score
DEFAULT_CHIP = "loihi1"  # of spiking policies where none is named
FLOAT = "float"  # in place of a chip: the float twin of a spiking policy


@dataclass(frozen=True)
class Candidate:
    """A policy that can be run, before it is loaded.

    path      of the file or run folder, or the name of a built-in
    name      short, for tables
    kind      "ann", "snn", "control", or one of BASELINES
    format    key of registry.FORMATS
    env       id of the environment it was made for; None fits any
    observed  numbers it observes; None fits any
    actions   numbers it puts out, or actions that it chooses from; None fits any
    limits    whether a chip refuses it when it breaks a design rule
    quantisation  of a spiking policy on a chip
    faults    of that chip
    backend   what computes that chip
    chip      whose integers it was trained in; None where it was trained for none
    units     of a teacher's actions, "own" or "scaled"; None for those that its kind has
    """

    path: str
    name: str
    kind: str
    format: str
    env: str | None = None
    observed: int | None = None
    actions: int | None = None
    limits: bool = True
    quantisation: Quantisation = PLAIN
    faults: Faults = NONE
    backend: BackendName = "numpy"
    chip: str | None = None
    units: Literal["own", "scaled"] | None = None


class Player(Protocol):
    """A loaded policy: a controller that also answers for a recorded episode."""

    def reset(self, seed: int) -> None:
        """Start an episode."""

    def act(self, observation: "Floats") -> "Floats":
        """The action (act,), or () where it is one of several, for an observation (obs,)."""

    def replay(self, observations: "Floats") -> "Floats":
        """The actions (S, act) or (S,) for the observations (S, obs) of an episode, in order."""


class PolicyFormat(Protocol):
    """The functions of a module that registry.FORMATS names."""

    def describe(self, path: Path) -> Candidate:
        """The candidate at a path; a built-in gets its name."""

    def controller(
        self, candidate: Candidate, chip: str | None, env: "gymnasium.Env[Any, Any]", sampled: bool
    ) -> Player:
        """The loaded policy.

        chip     name of a chip, FLOAT, or None for what does not spike
        sampled  draw actions where the policy is a distribution over them
        """

    def costs(self, controller: Any, played: "Rollout") -> "Costs":  # noqa: ANN401
        """Costs of the inferences of a rollout that the controller has just played."""


def env_id(name: str) -> str | None:
    """The id of an environment named in a file, short or long; None where it names none."""
    from spikedeploy.envs import ENVS

    return ENVS[name].id if name in ENVS else name or None


def check_fit(candidate: Candidate, env: "gymnasium.Env[Any, Any]") -> None:
    """Refuse an environment that the candidate was not made for."""
    made_for, here = candidate.env, env.spec.id if env.spec else None
    if made_for not in (None, here):
        raise ConfigError(f"{candidate.path} was made for {made_for}, not for {here}")
    sizes: Mapping[str, tuple[int | None, int]] = {
        "observes": (candidate.observed, _size(env.observation_space)),
        "puts out": (candidate.actions, _size(env.action_space)),
    }
    for verb, (found, wanted) in sizes.items():
        if found not in (None, wanted):
            raise ConfigError(f"{candidate.path} {verb} {found} numbers; {here} has {wanted}")


def _size(space: "gymnasium.Space[Any]") -> int:
    """Numbers of a box, or actions to choose from."""
    return int(getattr(space, "n", math.prod(space.shape or ())))
