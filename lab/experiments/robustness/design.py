"""The design of the robustness experiment: policies, conditions, episodes."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

from lab.experiments.robustness.lineup import Tested, files_of, named, shipped
from spikedeploy import envs
from spikedeploy.envs.disturbances import Kind, kinds_of, row
from spikedeploy.envs.errors import EnvError
from spikedeploy.make_env import make_env, parse_options
from spikedeploy.requests import LEVELS
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.faults import FAULTS

ENVS = ("hexapod", "hexapod-command", "kart-grid", "kart-gazebo", "kart-steer")
_OF_NUMBERS = ("noise", "bias")
UNDISTURBED, DISTURBANCE, FAULT = "undisturbed", "disturbance", "fault"


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

    env        short name, id of gymnasium, or module:Class
    runs       folder of the rows, a file each
    episodes   of each policy in each condition, from seed EVALUATION on
    specimens  faulty chips of each fault and level, among which the episodes are divided
    chip       on which spiking policies run
    limit      control steps that an episode may take; None for all
    quick      whether it is a first look, of seconds
    files      of policies; those that are shipped by default
    options    of the environment
    """

    env: str
    runs: str = ""
    episodes: int = 30
    specimens: int = 5
    chip: str = "loihi1"
    limit: int | None = None
    quick: bool = False
    files: Sequence[str] = ()
    options: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        try:
            foreign = envs.spec(self.env).foreign
        except EnvError as error:
            raise ConfigError(
                f"the robustness experiment has no environment {self.env!r}: {error}"
            ) from error
        if foreign and not self.files:
            raise ConfigError(
                f"no policies for {self.env} are shipped: name yours, as in --policies last"
            )

    @cached_property
    def policies(self) -> list[Tested]:
        """Those that were named, or all that are shipped; spiking ones on the chip."""
        return named(self.files, self.chip) if self.files else shipped(self.env, self.chip)

    def conditions(self, name: str) -> list[Condition]:
        """The conditions of a part: every level of a disturbance or fault, or the undisturbed."""
        if name == UNDISTURBED:
            return [Condition()]
        if name in FAULTS:
            kind, part = FAULTS[name], FAULT
            numbers: Sequence[float] = kind.levels
            unit = kind.unit
        else:
            disturbance = self._kinds[name]
            numbers, part = disturbance.levels[row(self._world)], DISTURBANCE
            unit = disturbance.unit
        pairs = zip(LEVELS, numbers, strict=True)
        return [Condition(part, name, level, number, unit) for level, number in pairs]

    @property
    def parts(self) -> list[str]:
        """The undisturbed, then names of disturbances and faults."""
        return [UNDISTURBED, *self._kinds, *FAULTS]

    @cached_property
    def _kinds(self) -> dict[str, Kind]:
        """Disturbances that the world has; one of several levels has neither noise nor bias."""
        found = kinds_of(self._world)
        if envs.spec(self.env).foreign:
            world = make_env(self.env, self.options)
            if getattr(world.unwrapped, "one_hot", False):
                found = {name: kind for name, kind in found.items() if name not in _OF_NUMBERS}
            world.close()
        return found

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


_OPTIONS = ("env", "runs", "episodes", "chip", "quick", "policies", "set")
_QUICK = {"episodes": 2, "specimens": 2, "limit": 25}


def asked(options: Mapping[str, Any]) -> RobustnessDesign:
    """The design of the options of a command; ConfigError where one is of other experiments."""
    if other := sorted(options.keys() - set(_OPTIONS)):
        raise ConfigError(f"the experiment robustness has no {other[0]}. Leave it out.")
    if "env" not in options:
        raise ConfigError(f"the experiment robustness needs an environment: {', '.join(ENVS)}")
    env, quick = options["env"], options.get("quick", False)
    runs = Path("runs") / ("robustness-quick" if quick else "robustness") / file_name(env)
    given = {name: value for name, value in options.items() if name not in ("policies", "set")}
    settings = parse_options(options.get("set", ()))
    names = [name for text in options.get("policies", ()) for name in text.split(",") if name]
    files = files_of(names, env, settings) if names else ()
    found = {"runs": str(runs), **(_QUICK if quick else {}), **given}
    return RobustnessDesign(**found, files=files, options=settings)


def file_name(env: str) -> str:
    """The name of an environment in names of files: `my_module:MyEnv` is `my_module-MyEnv`."""
    return re.sub(r"[^\w.-]+", "-", env)
