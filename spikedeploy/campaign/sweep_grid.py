"""SPEC.toml of a sweep as jobs: the axes of its grid, and the combinations that mean something."""

import hashlib
import json
import math
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import asdict, field, fields, replace
from dataclasses import dataclass as plain_dataclass
from functools import cache, cached_property
from itertools import pairwise, product
from pathlib import Path
from typing import Annotated, Any, TypeVar

from pydantic import AfterValidator, BeforeValidator, Field
from pydantic.dataclasses import dataclass

from spikedeploy import envs, zoo
from spikedeploy.console import say
from spikedeploy.envs.disturbances import disturbances
from spikedeploy.envs.repeats import check_repeats
from spikedeploy.make_env import make_env
from spikedeploy.policies.registry import BUILT_IN, DEFAULT_CHIP, FLOAT, Candidate, check_fit, find
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.chips.quantisation import PLAIN, Quantisation
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.faults import faults
from spikedeploy.runtime.files import read_toml
from spikedeploy.runtime.schema import validate
from spikedeploy.seeds import EVALUATION, listed_numbers
from spikedeploy.setup import check_metrics
from spikedeploy.trainers.config import require_known
from spikedeploy.trainers.versions import installed_version

OWN, NONE = "own", "none"  # the chip's own bits; no disturbance or fault
_VERSION = 1  # of what a result holds; a higher one makes all results again
_MOST = 100_000  # jobs: planning takes a second or two for each 10,000
# what an episode is computed with, by world; other people's worlds may stand on MuJoCo
_PHYSICS = {"hexapod": ("mujoco",), "kart": ("pymunk",)}
_OTHERS = ("gymnasium", "mujoco")
_ALWAYS = ("spikedeploy", "numpy", "onnxruntime")

T = TypeVar("T")


def _listed(value: object) -> object:
    return tuple(value) if isinstance(value, list | tuple) else (value,)


def _together(value: object) -> object:
    """Disturbances or faults of one job: a text, several in a list, or none."""
    return () if value == NONE else _listed(value)


def _folder_name(name: str) -> str:
    if name.startswith(".") or any(letter in name for letter in "/\\\0"):
        raise ValueError("it must be the name of a folder, without slashes")
    return name


def _quantisation(table: object) -> object:
    if isinstance(table, dict):
        names = [each.name for each in fields(Quantisation) if each.name != "tuned"]
        for name in table:
            require_known(name, names, "key of quantisation")
    return table


def _metrics(texts: tuple[str, ...]) -> tuple[str, ...]:
    check_metrics(texts)
    return texts


Axis = Annotated[tuple[T, ...], BeforeValidator(_listed)]
Whole = Annotated[int, Field(strict=True, ge=0)]
Positive = Annotated[int, Field(strict=True, ge=1)]
Bits = Annotated[Positive | None, BeforeValidator(lambda bits: None if bits == OWN else bits)]
Together = Annotated[tuple[str, ...], BeforeValidator(_together)]


@dataclass(frozen=True)
class SweepGrid:
    """The axes of a sweep, and what its jobs have in common.

    name      of the sweep; that of its file
    env       short names, ids of gymnasium, or module:Class
    policy    files, run folders, shipped names; none stands for all that are shipped
    chip      of spiking policies; "float" is the float twin; none stands for that which each was
              trained for, or the default
    bits      of the weights on those chips; None is the chip's own number
    disturb   disturbances of the world, those of one job together
    fault     faults of the chip, likewise
    specimen  which faulty chip
    seed      first seed of each job; (n,)
    episodes  of a job, from its seed on
    options   of the environment
    limits    refuse what breaks a design rule of the chip
    quantisation  of spiking policies on chips
    metrics   of the step infos, `name:mean|last|max`
    """

    name: Annotated[str, Field(min_length=1, max_length=100), AfterValidator(_folder_name)]
    env: Axis[str]
    policy: Axis[str] = ()
    chip: Axis[str] = ()
    bits: Axis[Bits] = (None,)
    disturb: Axis[Together] = ((),)
    fault: Axis[Together] = ((),)
    specimen: Axis[Whole] = (0,)
    seed: Axis[Whole] = (EVALUATION,)
    episodes: Positive = 10
    options: dict[str, Any] = field(default_factory=dict)
    limits: bool = True
    quantisation: Annotated[Quantisation, BeforeValidator(_quantisation)] = PLAIN
    metrics: Annotated[Axis[str], AfterValidator(_metrics)] = ()

    def __post_init__(self) -> None:
        for axis in ("env", "policy", "chip", "bits", "disturb", "fault", "specimen", "seed"):
            values = getattr(self, axis)
            if not values and axis not in ("policy", "chip"):
                raise ConfigError(f"{axis} is empty, so there is nothing to do. Name one.")
            if twice := [each for each, count in Counter(values).items() if count > 1]:
                raise ConfigError(f"{axis}: {_shown(twice[0])} is given twice. Give each once.")
        axes = (self.bits, self.disturb, self.fault, self.specimen, self.seed)
        several = (self.env, self.policy or (None,), self.chip or (None,), *axes)
        if (jobs := math.prod(map(len, several))) > _MOST:
            raise ConfigError(f"{jobs:,} jobs; at most {_MOST:,} in a sweep. Split the grid.")
        self._check_seeds()

    def _check_seeds(self) -> None:
        seeds = sorted(self.seed)
        if seeds[0] < EVALUATION:
            raise ConfigError(
                f"seed {seeds[0]} may have been trained on; evaluation starts at {EVALUATION}"
            )
        for lower, upper in pairwise(seeds):
            if upper - lower < self.episodes:
                raise ConfigError(
                    f"seed: jobs from {lower} and from {upper} on share episodes, as each has "
                    f"{self.episodes}. Leave that many seeds between them, or write a range: "
                    f"seed = '{seeds[0]}-{seeds[-1] + self.episodes - 1}'."
                )


def _shown(value: object) -> str:
    return " with ".join(value) or NONE if isinstance(value, tuple) else f"{value or OWN}"


def read_grid(path: Path) -> SweepGrid:
    """The grid in a TOML file; ConfigError names the key that is wrong, or unknown."""
    try:
        found = read_toml(path)
    except OSError as error:
        raise ConfigError(f"cannot read {path}: {error.strerror}") from error
    except (ValueError, RecursionError) as error:
        raise ConfigError(f"{path} is not valid TOML: {error}") from error
    try:
        for key in found:
            require_known(key, [each.name for each in fields(SweepGrid)], "key")
        seeds, episodes = found.get("seed"), found.get("episodes", SweepGrid.episodes)
        if isinstance(seeds, str) and isinstance(episodes, int) and episodes > 0:
            found["seed"] = listed_numbers("seed", seeds)[::episodes]  # a range, divided into jobs
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}") from error
    return validate(SweepGrid, {"name": path.stem, **found}, path)


@plain_dataclass(frozen=True)
class JobSpecification:
    """All that the result of a job depends on, JSON types; one value of each axis of the grid.

    format    key of policies.registry.FORMATS
    sha256    of the policy's file; empty for a built-in
    chip      of a spiking policy, or "float"; None for what does not spike
    limits    whether the design rules of the chip are enforced
    quantisation  fields of Quantisation
    versions  package -> version that computes it
    version   of what a result holds
    """

    env: str
    options: Mapping[str, Any]
    policy: str
    format: str
    sha256: str
    chip: str | None
    bits: int | None
    disturb: tuple[str, ...]
    fault: tuple[str, ...]
    specimen: int
    seed: int
    episodes: int
    limits: bool
    quantisation: Mapping[str, Any]
    metrics: tuple[str, ...] = ()
    versions: Mapping[str, str | None] = field(default_factory=dict)
    version: int = _VERSION

    @cached_property
    def record(self) -> dict[str, Any]:
        """The fields as JSON has them."""
        record: dict[str, Any] = json.loads(json.dumps(asdict(self)))
        return record

    @cached_property
    def key(self) -> str:
        """SHA-256 of the fields, in hexadecimal; the name of the job's file."""
        text = json.dumps(self.record, sort_keys=True, separators=(",", ":"))
        return hashlib.sha256(text.encode()).hexdigest()

    @property
    def place(self) -> str | None:
        """The chip as the command line takes it: `loihi1:weight_bits=4`."""
        if self.bits is None or self.chip in (None, FLOAT):
            return self.chip
        return f"{self.chip}{',' if ':' in self.chip else ':'}weight_bits={self.bits}"

    @property
    def label(self) -> str:
        """`kart-grid · snn · loihi1 · noise:2 · seed 10000`, for messages."""
        specimen = [f"specimen {self.specimen}"] if self.fault else []
        parts = [self.env, self.policy, self.place, *self.disturb, *self.fault, *specimen]
        return " · ".join(part for part in (*parts, f"seed {self.seed}") if part)

    @cached_property
    def cell(self) -> str:
        """The key of what jobs have in common that differ in their seeds alone."""
        return replace(self, seed=0).key


@plain_dataclass(frozen=True)
class SweepPlan:
    """The jobs of a sweep.

    jobs      in the order of the axes, the seed last
    policies  sha256 -> bytes of the file; a worker may have another disk
    """

    jobs: list[JobSpecification]
    policies: dict[str, bytes]


def expand(grid: SweepGrid) -> SweepPlan:
    """All jobs of a grid, each once; ConfigError where an axis has what does not exist."""
    for texts in grid.fault:
        faults(texts)
    for env, texts in product(grid.env, grid.disturb):
        disturbances(texts, envs.spec(env).world)
    _check_chips(grid.chip, grid)
    policies: dict[str, bytes] = {}
    jobs: dict[str, JobSpecification] = {}
    for env, candidates in _fitting(grid).items():
        for candidate in candidates:
            if candidate.kind == "snn" and not grid.chip:
                _check_chips((candidate.chip or DEFAULT_CHIP,), grid)
            for job in _jobs(grid, env, candidate, _policy_fields(candidate, policies)):
                jobs.setdefault(job.key, job)
    if not jobs:
        raise ConfigError(
            "no job is left: bits and faults are of chips, and no policy runs on one here. Add "
            '"own" to bits, "none" to fault, or a policy that spikes.'
        )
    return SweepPlan(list(jobs.values()), policies)


def _check_chips(names: tuple[str, ...], grid: SweepGrid) -> None:
    for name, bits in product(names, grid.bits):
        if name != FLOAT:
            chip(name, **({} if bits is None else {"weight_bits": bits}))


def _fitting(grid: SweepGrid) -> dict[str, list[Candidate]]:
    """Environment -> the policies that are made for it; each policy must be for one of them."""
    from spikedeploy.shipping.exported_run import runnable

    named = [find(runnable(name)) for name in grid.policy]
    short = [candidate.name for candidate in named]
    if len(named) > len({(each.name, each.env) for each in named}):
        twice = next(name for name in short if short.count(name) > 1)
        raise ConfigError(f"policy: two are called {twice}. Give one of them another name.")
    found: dict[str, list[Candidate]] = {}
    for env in grid.env:
        shipped = [find(str(path)) for path in zoo.policies(env)] if not named else []
        fits = (None, envs.spec(env).id)
        found[env] = [each for each in [*named, *shipped] if each.env in fits]
        if not found[env]:
            raise ConfigError(f"policy: none is for {env}. Name one, such as {env}/snn or random.")
        world = make_env(env, grid.options)
        for candidate in found[env]:
            check_fit(candidate, world)
        world.close()
        if remark := check_repeats(env, grid.options):
            say(remark)
    for each in named:
        if not any(each in many for many in found.values()):
            raise ConfigError(f"policy: {each.name} is for {each.env}, which env does not name")
    return found


def _policy_fields(candidate: Candidate, policies: dict[str, bytes]) -> dict[str, Any]:
    """The fields of a job that say which policy; the bytes of its file are kept."""
    sha256 = ""
    if candidate.format not in BUILT_IN:
        path = Path(candidate.path)
        sha256 = zoo.sha256(path)
        policies[sha256] = path.read_bytes()
    return {"policy": candidate.name, "format": candidate.format, "sha256": sha256}


def _jobs(
    grid: SweepGrid, env: str, candidate: Candidate, policy: dict[str, Any]
) -> Iterator[JobSpecification]:
    """The jobs of a policy; those that differ in what it does not have are alike."""
    spikes = candidate.kind == "snn"
    quantisation = asdict(grid.quantisation)
    del quantisation["tuned"]
    chips = grid.chip or (candidate.chip or DEFAULT_CHIP,)
    axes = (chips, grid.bits, grid.disturb, grid.fault, grid.specimen, grid.seed)
    for name, bits, disturb, fault, specimen, seed in product(*axes):
        on_chip = spikes and name != FLOAT
        if fault and not on_chip:
            continue  # faults are of chips
        yield JobSpecification(
            env=env,
            options=dict(grid.options),
            **policy,
            chip=name if spikes else None,
            bits=bits if on_chip else None,
            disturb=disturb,
            fault=fault,
            specimen=specimen if fault else 0,
            seed=seed,
            episodes=grid.episodes,
            limits=grid.limits if on_chip else True,
            quantisation=quantisation if on_chip else {},
            metrics=grid.metrics,
            versions=versions_for(env),
        )


@cache
def versions_for(env: str) -> dict[str, str | None]:
    """Package -> version of what computes an episode in an environment, here."""
    packages = (*_ALWAYS, *_PHYSICS.get(envs.spec(env).world, _OTHERS))
    return {package: installed_version(package) for package in packages}
