"""The robustness experiment: return under disturbances of the world and faults of the chip.

Each row is a file of its own, <runs>/<condition>/<policy>.json, which says what it was made with: a
stopped experiment goes on after the last row, and a row whose policy, level or sizes have changed
is made again. All policies of a part share the copies of the environment.
"""

import hashlib
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from lab.experiments.networks import BatchOnChip
from lab.experiments.runner import Design, Part
from lab.experiments.training import Record, StoredRow, is_complete
from spikedeploy import envs, zoo
from spikedeploy.envs.disturbances import Kind, kinds_of
from spikedeploy.envs.disturbances import row as row_of
from spikedeploy.envs.errors import EnvError
from spikedeploy.make_env import make_env, parse_options
from spikedeploy.policies.onnx import OnnxController
from spikedeploy.policies.registry import BUILT_IN, Candidate, check_fit, find
from spikedeploy.requests import LEVELS
from spikedeploy.runtime.artifact.artifact import load
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.chips.damage import Damage, summed
from spikedeploy.runtime.emulator.controllers import SpikingController
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.faults import FAULTS, faults
from spikedeploy.seeds import EVALUATION
from spikedeploy.shipping.exported_run import runnable
from spikedeploy.trainers.config import EnvConfig
from spikedeploy.trainers.sparse.pool import Episodes, Stateless

ENVS = ("hexapod", "hexapod-command", "kart-grid", "kart-gazebo", "kart-steer")
_OF_NUMBERS = ("noise", "bias")
UNDISTURBED, DISTURBANCE, FAULT = "undisturbed", "disturbance", "fault"
_VERSION = 1  # of what a row holds; a higher one makes all rows again
_QUICK_PARTS = 8  # of a job
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


def shipped(env: str, chip: str) -> list[Tested]:
    """The shipped float ANNs, small float networks, and spiking policies on the chip."""
    every = [find(str(path)) for path in zoo.policies(env)]
    small = [c for name in _SMALL for c in every if c.name == name and c.kind != "snn"]
    found = [c for c in every if c.kind == "ann" and c not in small]
    spiking = [c for c in every if c.kind == "snn" and c.format == ".nir"]
    return [Tested(c, None) for c in [*found, *small]] + [Tested(c, chip) for c in spiking]


def named(paths: Sequence[str], chip: str) -> list[Tested]:
    """Files, float ones first, as `files_of` gave them; those that spike on the chip."""
    found = [find(path) for path in paths]
    tested = [Tested(each, chip if each.kind == "snn" else None) for each in found]
    return sorted(tested, key=lambda each: each.chip is not None)


def files_of(names: Sequence[str], env: str, options: Mapping[str, Any]) -> list[str]:
    """Files of policies by name; run folders are exported. ConfigError where one does not fit."""
    if own := [name for name in names if name in BUILT_IN]:
        raise ConfigError(f"--policies {own[0]} is built in and has no file. Leave it out.")
    candidates = [find(runnable(name)) for name in names]
    world = make_env(env, options)
    for candidate in candidates:
        check_fit(candidate, world)
    world.close()
    short = [candidate.name for candidate in candidates]
    if twice := [name for name in short if short.count(name) > 1]:
        raise ConfigError(f"--policies: two are called {twice[0]}. Give one of them another name.")
    return [candidate.path for candidate in candidates]


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
class RobustnessDesign(Design):
    """The parts of the experiment in one environment.

    env        short name, id of gymnasium, or module:Class
    specimens  faulty chips of each fault and level, among which the episodes are divided
    files      of policies; those that are shipped by default
    options    of the environment
    """

    episodes: int = 30
    env: str = ""
    specimens: int = 5
    files: Sequence[str] = ()
    options: Mapping[str, Any] = field(default_factory=dict)

    NAME = "robustness"
    OPTIONS: ClassVar = {name: name for name in ("env", "runs", "episodes", "chip", "quick")} | {
        "policies": "files", "set": "options"
    }  # fmt: skip
    QUICK: ClassVar = {"episodes": 2, "specimens": 2, "limit": 25}

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
        super().__post_init__()

    @classmethod
    def of(cls, options: Mapping[str, Any]) -> Any:  # noqa: ANN401
        """The design of the options; files of policies are found, and fit the environment."""
        if "env" not in options and options.keys() <= cls.OPTIONS.keys():
            raise ConfigError(f"the experiment robustness needs an environment: {', '.join(ENVS)}")
        env = str(options.get("env"))
        folder = "robustness-quick" if options.get("quick") else "robustness"
        found = {"runs": str(Path("runs") / folder / file_name(env)), **options}
        if "set" in options:
            found["set"] = parse_options(options["set"])
        names = [n for text in options.get("policies", ()) for n in text.split(",") if n]
        if names:
            found["policies"] = files_of(names, env, found.get("set", {}))
        return super().of(found)

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
            numbers, part = disturbance.levels[row_of(self._world)], DISTURBANCE
            unit = disturbance.unit
        pairs = zip(LEVELS, numbers, strict=True)
        return [Condition(part, name, level, number, unit) for level, number in pairs]

    @property
    def names(self) -> list[str]:
        """Names of the parts: the undisturbed, then of disturbances and faults."""
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

    def parts(self) -> list[Part]:
        """One for each disturbance or fault, and the undisturbed."""
        return [self._part(name) for name in self.names]

    def _part(self, name: str) -> Part:
        return Part(name, lambda: not self.is_missing(name), lambda: self._complete(name))

    def bundles(self, names: list[str]) -> list[list[str]]:
        """A job a part; of a quick look, whose parts are shorter than a start, one for many."""
        size = _QUICK_PARTS if self.quick else 1
        return [names[at : at + size] for at in range(0, len(names), size)]

    def check(self, results: Path) -> None:
        """Nothing is trained."""

    # rows

    def stored(self, condition: Condition, tested: Tested) -> StoredRow:
        """The row of a policy in a condition."""
        made = {
            "env": self.env,
            "policy": tested.digest,
            "chip": tested.chip,
            "condition": condition.text,
            "number": condition.number,
            "episodes": self.episodes,
            "specimens": self.specimens if condition.part == FAULT else None,
            "first_seed": EVALUATION,
            "limit": self.limit,
            "version": _VERSION,
            **({"options": dict(self.options)} if self.options else {}),
        }
        folder = Path(self.runs) / condition.text.replace(":", "-")
        name = f"{tested.candidate.name}{f'@{tested.chip}' if tested.chip else ''}.json"
        return StoredRow(folder / name.replace(":", "-"), made)

    def _rows(self, part: str) -> Iterator[StoredRow]:
        for condition in self.conditions(part):
            for tested in self.tested(part):
                yield self.stored(condition, tested)

    def is_missing(self, part: str) -> bool:
        """Whether a row of a part is missing."""
        return not is_complete(self._rows(part))

    def all_rows(self) -> Iterator[Record]:
        """The results so far, part by part."""
        for part in self.names:
            for row in self._rows(part):
                if (found := row.found) is not None:
                    yield found

    def _complete(self, part: str) -> None:
        episodes: Episodes | None = None
        for condition in self.conditions(part):
            if condition.part == DISTURBANCE:
                episodes = None  # each level is another world
            for tested in self.tested(part):
                row = self.stored(condition, tested)
                if row.found is None:
                    episodes = episodes or self._episodes(condition)
                    row.write(self._evaluate(condition, tested, episodes))

    def _episodes(self, condition: Condition) -> Episodes:
        disturb = {"disturb": [condition.text]} if condition.part == DISTURBANCE else {}
        options = {**self.options, **disturb}
        config = EnvConfig(name=self.env, options=options, count=self.episodes)
        return Episodes(config, self.episodes, self.limit)

    def groups(self, condition: Condition) -> list[int]:
        """What an interval resamples together (n,): the specimen of each episode, else each."""
        apart = self.specimens if condition.part == FAULT else self.episodes
        return [k % apart for k in range(self.episodes)]

    def _evaluate(self, condition: Condition, tested: Tested, episodes: Episodes) -> Record:
        """What the policy earns, episode by episode, and what faults of the chip hit."""
        returns, successes = np.zeros(self.episodes), np.zeros(self.episodes, np.bool_)
        is_known = True  # whether the environment says what a success is
        damages: list[Sequence[Damage]] = []
        groups = np.array(self.groups(condition))
        for specimen in range(groups.max() + 1 if condition.part == FAULT else 1):
            of_specimen = groups == specimen if condition.part == FAULT else np.ones_like(groups)
            places = np.flatnonzero(of_specimen)
            seeds = (EVALUATION + places).tolist()
            if tested.chip is None:
                act = OnnxController(tested.candidate.path).replay
                _, returns[places], infos = episodes.play(seeds, Stateless(act))
            else:
                broken = [condition.text] if condition.part == FAULT else []
                spiking = SpikingController(
                    load(tested.candidate.path), chip(tested.chip), "none",
                    faults=faults(broken, specimen),
                )  # fmt: skip
                _, returns[places], infos = episodes.play(seeds, BatchOnChip(spiking, seeds))
                damages += [spiking.damage] if spiking.damage else []
            successes[places] = [bool(info.get("success", False)) for info in infos]
            is_known = is_known and all("success" in info for info in infos)
        return {
            "env": self.env,
            "policy": tested.label,
            "kind": tested.candidate.kind,
            "chip": tested.chip,
            "part": condition.part,
            "name": condition.name,
            "level": condition.level,
            "number": condition.number,
            "unit": condition.unit,
            "episodes": self.episodes,
            "return_mean": float(returns.mean()),
            "success_rate": float(successes.mean()) if is_known else None,
            **_hits(damages),
            "groups": groups.tolist(),
            "returns": returns.tolist(),
            "successes": successes.astype(int).tolist() if is_known else None,
        }

    def write(self, results: Path) -> list[Path]:
        """Write page, table and picture of the complete rows; return the files."""
        from lab.experiments.robustness_page import write

        return write(self, results)


def _hits(damages: Sequence[Sequence[Damage]]) -> Record:
    """Parts of all specimens together, or what happened in all episodes."""
    found = summed(damages)
    return {"hit": found[0].hit, "of": found[0].of, "what": found[0].what} if found else {}


def file_name(env: str) -> str:
    """The name of an environment in names of files: `my_module:MyEnv` is `my_module-MyEnv`."""
    return re.sub(r"[^\w.-]+", "-", env)
