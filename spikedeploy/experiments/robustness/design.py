"""The design of the robustness experiment: policies, conditions, episodes."""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from spikedeploy import envs, zoo
from spikedeploy.envs.disturbances.disturbed import LEVELS, kinds_of
from spikedeploy.policies.interface import Candidate
from spikedeploy.policies.registry import find
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.faults import FAULTS
from spikedeploy.runtime.faults.request import fault

ENVS = ("hexapod", "hexapod-command", "kart-grid", "kart-gazebo", "kart-steer")
UNDISTURBED, DISTURBANCE, FAULT = "undisturbed", "disturbance", "fault"
# float controls beside the float ANN, as far as they are shipped, from the strongest on
_SMALL = ("mlp-32", "pruned", "small", "linear")


@dataclass(frozen=True)
class Tested:
    """A policy of the line-up.

    candidate  the policy
    chip       on which it runs if it spikes, else None
    """

    candidate: Candidate
    chip: str | None

    @cached_property
    def digest(self) -> str:
        """SHA-256 of its file."""
        return hashlib.sha256(Path(self.candidate.path).read_bytes()).hexdigest()

    @property
    def label(self) -> str:
        """`popsan · loihi1`, `sac`."""
        return f"{self.candidate.name} · {self.chip}" if self.chip else self.candidate.name


@dataclass(frozen=True)
class Condition:
    """What is wrong.

    part    UNDISTURBED, DISTURBANCE or FAULT
    name    of the disturbance or fault; empty where nothing is wrong
    level   1 to 3; 0 where nothing is wrong
    number  of that level
    unit    of the number
    """

    part: str = UNDISTURBED
    name: str = ""
    level: int = 0
    number: float = 0.0
    unit: str = ""

    @property
    def text(self) -> str:
        """`noise:2`, as the command line takes it; `undisturbed`."""
        return f"{self.name}:{self.level}" if self.name else UNDISTURBED


@dataclass(frozen=True)
class RobustnessDesign:
    """The parts of the experiment in one environment.

    env        short name
    runs       folder of the rows, a file each
    episodes   of each policy in each condition, from seed EVALUATION on
    specimens  faulty chips of each fault and level, among which the episodes are divided
    chip       on which spiking policies run
    limit      control steps that an episode may take; None for all
    quick      whether it is a first look, of seconds
    """

    env: str
    runs: str = ""
    episodes: int = 30
    specimens: int = 5
    chip: str = "loihi1"
    limit: int | None = None
    quick: bool = False

    def __post_init__(self) -> None:
        if self.env not in ENVS:
            raise ConfigError(
                f"the robustness experiment has no environment {self.env!r}; known: "
                f"{', '.join(ENVS)}"
            )

    @cached_property
    def policies(self) -> list[Tested]:
        """The shipped float ANNs, small float networks, and spiking policies on the chip."""
        shipped = [find(str(path)) for path in zoo.policies(self.env)]
        small = [c for name in _SMALL for c in shipped if c.name == name and c.kind != "snn"]
        found = [c for c in shipped if c.kind == "ann" and c not in small]
        spiking = [c for c in shipped if c.kind == "snn" and c.format == ".nir"]
        return [Tested(c, None) for c in [*found, *small]] + [Tested(c, self.chip) for c in spiking]

    def conditions(self, name: str) -> list[Condition]:
        """The conditions of a part: every level of a disturbance or fault, or the undisturbed."""
        if name == UNDISTURBED:
            return [Condition()]
        if name in FAULTS:
            kind, part = fault(name), FAULT
            numbers: Sequence[float] = kind.levels
            unit = kind.unit
        else:
            disturbance = kinds_of(self._world)[name]
            numbers, part = disturbance.levels[self._world], DISTURBANCE
            unit = disturbance.unit
        pairs = zip(LEVELS, numbers, strict=True)
        return [Condition(part, name, level, number, unit) for level, number in pairs]

    @property
    def parts(self) -> list[str]:
        """The undisturbed, then names of disturbances and faults."""
        return [UNDISTURBED, *kinds_of(self._world), *FAULTS]

    @property
    def _world(self) -> str:
        return envs.spec(self.env).world

    def tested(self, name: str) -> list[Tested]:
        """The policies of a part: faults are of chips."""
        found = self.policies
        return [each for each in found if each.chip] if name in FAULTS else found

    def arguments(self) -> dict[str, Any]:
        """The fields as arguments of a job."""
        return asdict(self)


_OPTIONS = ("env", "runs", "episodes", "chip", "quick")
_QUICK = {"episodes": 2, "specimens": 2, "limit": 25}


def asked(options: Mapping[str, Any]) -> RobustnessDesign:
    """The design of the options of a command; ConfigError where one is of other experiments."""
    if other := sorted(options.keys() - set(_OPTIONS)):
        raise ConfigError(f"the experiment robustness has no {other[0]}. Leave it out.")
    if "env" not in options:
        raise ConfigError(f"the experiment robustness needs an environment: {', '.join(ENVS)}")
    quick = options.get("quick", False)
    runs = Path("runs") / ("robustness-quick" if quick else "robustness") / options["env"]
    return RobustnessDesign(**{"runs": str(runs), **(_QUICK if quick else {}), **options})
