"""Policies of every format: found by name, described, and loaded as players.

A new format is a class beside these, and a line in FORMATS.
"""

import difflib
import math
import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, cast

import numpy as np
from numpy.typing import NDArray

from spikedeploy import zoo
from spikedeploy.evaluation_setup import DEFAULT, Setup
from spikedeploy.objects import is_of_process
from spikedeploy.runtime.codec.codec import observed_numbers
from spikedeploy.runtime.copies import NotCopyable
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.files import suffix

if TYPE_CHECKING:
    import gymnasium

    from spikedeploy.envs.rollout import Rollout
    from spikedeploy.policies.costs import Costs
    from spikedeploy.runtime.chips.damage import Damage

Floats = NDArray[np.float64]
Env: TypeAlias = "gymnasium.Env[Any, Any]"

FORMATS = {
    ".onnx": "onnx:OnnxController",
    ".nir": "nir:NirController",
    ".so": "native:NativeController",
    "run": "run_record:TorchController",
    "gait": "scripts:ZeroController",
    "random": "scripts:RandomController",
    "gap": "scripts:GapController",
    "expert": "scripts:ExpertController",
    "teacher": "scripts:TeacherController",
    "function": "scripts:TeacherController",
}
BASELINES = ("gait", "random")  # kinds without a trained policy: the zero of a normalised score
DEFAULT_CHIP = "loihi1"  # of spiking policies where none is named
FLOAT = "float"  # in place of a chip: the float twin of a spiking policy


@dataclass(frozen=True)
class Candidate:
    """A policy that can be run, before it is loaded.

    path: path of the file or run folder, or the name of a built-in
    name: short, for tables
    kind: "ann", "snn", "control", or one of BASELINES
    format: key of FORMATS
    env: id of the environment it was made for; None fits any
    observed: numbers it observes; None fits any
    actions: numbers it puts out, or actions that it chooses from; None fits any
    chip: whose integers it was trained in; None where it was trained for none
    units: units of a teacher's actions, "own" or "scaled"; None for those that its kind has
    """

    path: str
    name: str
    kind: str
    format: str
    env: str | None = None
    observed: int | None = None
    actions: int | None = None
    chip: str | None = None
    units: Literal["own", "scaled"] | None = None

    @property
    def default_chip(self) -> str | None:
        """The chip that runs it where none is named; FLOAT for a run folder, which none runs."""
        if self.kind != "snn":
            return None
        return self.chip or DEFAULT_CHIP if self.format == ".nir" else FLOAT


@dataclass(frozen=True)
class Entry:
    """One row of a comparison, before it is played.

    candidate: the policy
    chip: a chip, "float" for the float twin of a spiking policy, None for what does not spike
    reference: the entry it is measured against: the float ANN; on a chip its float twin
    setup: setup of the evaluation, which all entries of a comparison share
    """

    candidate: Candidate
    chip: str | None = None
    reference: "Entry | None" = None
    setup: Setup = DEFAULT

    @property
    def label(self) -> str:
        """The name in tables: `popsan · loihi1`."""
        if self.chip is None:
            return self.candidate.name
        remarks = "" if self.limits else ", limits off"
        faulty = ", faulty" if self.on_chip and self.setup.faults else ""
        return f"{self.candidate.name} · {self.chip}{remarks}{faulty}"

    @property
    def on_chip(self) -> bool:
        """True where a chip is emulated."""
        return self.chip not in (None, FLOAT)

    @property
    def limits(self) -> bool:
        """True if the design rules of its chip were enforced."""
        return self.setup.limits == "on" or not self.on_chip

    @property
    def references(self) -> list["Entry"]:
        """Its reference, that one's reference, and so on up to the float ANN."""
        return [] if self.reference is None else [self.reference, *self.reference.references]

    @property
    def rank(self) -> int:
        """The number of entries that must be played before it."""
        return len(self.references)

    @property
    def remark(self) -> str:
        """The remark on a policy on another chip than it was trained for; empty on its own."""
        trained = self.candidate.chip
        if trained is None or self.chip in (None, trained) or trained == self.chip.split(":")[0]:
            return ""
        return f"{self.candidate.name} was trained for {trained}, and runs on {self.chip} here"


BUILT_IN = {
    "gait": Candidate("gait", "gait", "gait", "gait"),
    "random": Candidate("random", "random", "random", "random"),
    "gap": Candidate("gap", "gap", "control", "gap"),
    "expert": Candidate("expert", "expert", "control", "expert"),
}
_HINT = "`spikedeploy policies` lists what is shipped"
UNTRAINED = (*BUILT_IN, "function")  # formats of scripts


class Controller(NotCopyable):
    """A loaded policy: it acts in an environment, and answers for recorded episodes.

    Copies are refused unless a subclass is Copyable: a script reads a world, a session has no copy.

    Subclasses define `act` or `replay`, of which each is made of the other.

    remarks: remarks of the compiler, on where a chip departs from the file
    damage: damage by faults of the chip
    """

    instead = "Open the policy again."
    remarks: Sequence[str] = ()
    damage: "Sequence[Damage]" = ()

    @classmethod
    def describe(cls, path: Path) -> Candidate:
        """The candidate in a file or folder."""
        raise NotImplementedError

    @classmethod
    def open(cls, candidate: Candidate, chip: str | None, env: Env, setup: Setup) -> "Controller":
        """Load the candidate.

        chip: name of a chip, FLOAT, or None for what does not spike
        setup: how a chip runs it, and whether actions are drawn
        """
        raise NotImplementedError

    def reset(self, seed: int) -> None:
        """Start an episode; what has no state has nothing to do."""

    def act(self, observation: Floats) -> NDArray[Any]:
        """The action (act,), or () where it is one of several, for an observation (obs,)."""
        return np.asarray(self.replay(observed_numbers(observation)[None])[0])

    def replay(self, observations: Floats) -> NDArray[Any]:
        """The actions (S, act) or (S,) for the observations (S, obs) of an episode, in order."""
        return np.stack([self.act(observation) for observation in observations])

    def costs(self, played: "Rollout") -> "Costs":
        """Costs of the inferences of a rollout that it has just played; uncounted by default."""
        from spikedeploy.policies.costs import UNCOUNTED

        return UNCOUNTED


def find(reference: str) -> Candidate:
    """The candidate at a path, in the zoo (`hexapod/popsan`), or built in (`gait`, `gap`)."""
    from spikedeploy.envs.foreign import is_target

    if reference in BUILT_IN:
        return BUILT_IN[reference]
    path = zoo.resolve(reference)
    format_ = "run" if path and path.is_dir() else suffix(path or "")
    if path is not None and format_ in FORMATS:
        return _class_of(format_).describe(path)
    if format_ == ".zip" or (path is None and is_target(reference)):
        hint = f"a teacher plays in `spikedeploy compare ENV --teacher {shlex.quote(reference)}`"
    elif path is None:
        close = difflib.get_close_matches(reference, [*zoo.names(), *BUILT_IN], n=1)
        hint = f"did you mean {close[0]!r}?" if close else _HINT
    else:
        hint = "it is neither .onnx, .nir nor a run folder"
    raise ConfigError(f"no policy at {reference!r}: {hint}")


def open_policy(
    candidate: Candidate, chip: str | None, env: Env, setup: Setup = DEFAULT
) -> Controller:
    """Return the controller of the candidate in `env`; `chip` "float" is the float twin."""
    check_fit(candidate, env)
    if candidate.kind == "snn" and chip is None:
        raise ConfigError(f"{candidate.name} is a spiking policy: name a chip, or '{FLOAT}'")
    if candidate.kind != "snn" and chip is not None:
        raise ConfigError(f"{candidate.name} does not spike, so no chip runs it: leave --chip out")
    return _class_of(candidate.format).open(candidate, chip, env, setup)


def check_fit(candidate: Candidate, env: Env) -> None:
    """Refuse an environment that the candidate was not made for.

    A name that one process alone knows tells nothing of the environment; the sizes do.
    """
    made_for, here = candidate.env, env.spec.id if env.spec else None
    if made_for not in (None, here) and not (is_of_process(made_for) or is_of_process(here or "")):
        raise ConfigError(f"{candidate.path} was made for {made_for}, not for {here}")
    sizes = {
        "observes": (candidate.observed, env.observation_space),
        "puts out": (candidate.actions, env.action_space),
    }
    for verb, (found, space) in sizes.items():
        # numbers of a box, or actions to choose from
        wanted = int(getattr(space, "n", math.prod(space.shape or ())))
        if found not in (None, wanted):
            raise ConfigError(f"{candidate.path} {verb} {found} numbers; {here} has {wanted}")


def confirm(found: str, named: str | None, source: str) -> None:
    """Refuse module:Class that a file names, unless the user names it: its code would be run."""
    from spikedeploy.envs.foreign import is_target

    if is_target(found) and found != named:
        raise ConfigError(
            f"{source} was made for {found}, whose code is not run because a file names it: name "
            f"it yourself, with --env {found} (in Python env=, the class too)"
        )


def env_id(name: str) -> str | None:
    """The id of an environment named in a file, short or long; None where it names none."""
    from spikedeploy.envs import ENVS

    return ENVS[name].id if name in ENVS else name or None


def _class_of(format_: str) -> type[Controller]:
    """The class of a format, imported now."""
    module, _, name = FORMATS[format_].partition(":")
    found = getattr(import_module(f"spikedeploy.policies.{module}"), name)
    return cast("type[Controller]", found)
