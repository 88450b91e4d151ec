"""The registry of policies that can be run: files, run folders and built-ins, one table of formats.

A format is a module of `spikedeploy.formats` with three functions:

    describe(path) -> Candidate
    controller(candidate, chip, env, sampled) -> Player; `sampled` draws actions at random where
                                                 the policy is a distribution over them
    costs(player, rollout) -> Costs, of the inferences of a rollout that it has just played
"""

import difflib
import math
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, TypeAlias

from spikedeploy.runtime.chips.quantisation import PLAIN, Quantisation
from spikedeploy.runtime.errors import ConfigError

if TYPE_CHECKING:
    import gymnasium
    import numpy as np
    from numpy.typing import NDArray

    from spikedeploy.comparison.costs import Costs
    from spikedeploy.envs.rollout import Rollout

    Floats: TypeAlias = NDArray[np.float64]

FORMATS = {
    ".onnx": "spikedeploy.policies.onnx",
    ".nir": "spikedeploy.policies.nir",
    "run": "spikedeploy.policies.run",
    "gait": "spikedeploy.policies.gait",
    "random": "spikedeploy.policies.random",
    "gap": "spikedeploy.policies.gap",
}
BUILT_IN = ("gait", "random", "gap")
BASELINES = ("gait", "random")  # kinds of those that know nothing: the zero of a score
FLOAT = "float"


@dataclass(frozen=True)
class Candidate:
    """A policy that can be run, before it is loaded.

    path      of the file or run folder, or the name of a built-in
    name      short, for tables
    kind      "ann", "snn", "control", or one of BASELINES
    format    key of FORMATS
    env       id of the environment it was made for; None fits any
    observed  numbers it observes; None fits any
    actions   numbers it puts out, or actions that it chooses from; None fits any
    limits    whether a chip refuses it when it breaks a design rule
    quantisation  of a spiking policy on a chip
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


class Player(Protocol):
    """A controller that can also be asked about a recorded episode."""

    def reset(self, seed: int) -> None:
        """Start an episode."""

    def act(self, observation: "Floats") -> "Floats":
        """The action (act,), or () where it is one of several, for an observation (obs,)."""

    def replay(self, observations: "Floats") -> "Floats":
        """The actions (S, act) or (S,) for the observations (S, obs) of an episode, in order."""


def find(reference: str) -> Candidate:
    """The candidate at a path, in the zoo (`hexapod/popsan`), or built in (`gait`, `gap`)."""
    from spikedeploy import zoo

    if reference in BUILT_IN:
        return _describe(reference, Path(reference))
    path = Path(reference) if Path(reference).exists() else zoo.path(reference)
    if path is None:
        raise ConfigError(_unknown(reference, zoo.names()))
    return _describe(_format(path), path)


def open_policy(
    candidate: Candidate,
    chip: str | None,
    env: "gymnasium.Env[Any, Any]",
    sampled: bool = False,
) -> Player:
    """The player of the candidate in `env`; `chip` "float" is the float twin."""
    check_fit(candidate, env)
    if candidate.kind == "snn" and chip is None:
        raise ConfigError(f"{candidate.name} is a spiking policy: name a chip, or '{FLOAT}'")
    if candidate.kind != "snn" and chip is not None:
        raise ConfigError(f"{candidate.name} does not spike, so no chip runs it: leave --chip out")
    module = import_module(FORMATS[candidate.format])
    made: Player = module.controller(candidate, chip, env, sampled)
    return made


def price(candidate: Candidate, player: Player, played: "Rollout") -> "Costs":
    """What an inference cost the player in the rollout that it has just played."""
    costs: Costs = import_module(FORMATS[candidate.format]).costs(player, played)
    return costs


def check_fit(candidate: Candidate, env: "gymnasium.Env[Any, Any]") -> None:
    """Refuse an environment that the candidate was not made for."""
    made_for, here = candidate.env, env.spec.id if env.spec else None
    if made_for not in (None, here):
        raise ConfigError(f"{candidate.path} was made for {made_for}, not for {here}")
    sizes = {
        "observes": (candidate.observed, _size(env.observation_space)),
        "puts out": (candidate.actions, _size(env.action_space)),
    }
    for verb, (found, wanted) in sizes.items():
        if found not in (None, wanted):
            raise ConfigError(f"{candidate.path} {verb} {found} numbers; {here} has {wanted}")


def env_id(name: str) -> str | None:
    """The id of an environment named in a file, short or long; None where it names none."""
    from spikedeploy.envs import ENVS

    return ENVS[name].id if name in ENVS else name or None


def _size(space: "gymnasium.Space[Any]") -> int:
    """Numbers of a box, or actions to choose from."""
    return int(getattr(space, "n", math.prod(space.shape or ())))


def _describe(form: str, path: Path) -> Candidate:
    described: Candidate = import_module(FORMATS[form]).describe(path)
    return described


def _format(path: Path) -> str:
    if path.is_dir():
        return "run"
    if path.suffix in FORMATS:
        return path.suffix
    raise ConfigError(f"{path} is neither .onnx, .nir nor a run folder")


def _unknown(reference: str, known: list[str]) -> str:
    close = difflib.get_close_matches(reference, [*known, *BUILT_IN], n=1)
    hint = (
        f"did you mean {close[0]!r}?" if close else "`spikedeploy policies` lists what is shipped"
    )
    return f"no policy at {reference!r}: no such file, run folder or shipped policy; {hint}"
