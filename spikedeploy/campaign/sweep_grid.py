"""SPEC.toml of a sweep as jobs: the axes of its grid, and the combinations that mean something."""

import hashlib
import json
import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass as plain_dataclass
from dataclasses import fields, replace
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
from spikedeploy.evaluation_setup import DEFAULT, Setup
from spikedeploy.policies.registry import (
    BUILT_IN,
    DEFAULT_CHIP,
    FLOAT,
    Candidate,
    Entry,
    check_fit,
    find,
)
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.faults import faults
from spikedeploy.runtime.files import read_toml
from spikedeploy.runtime.schema import validate
from spikedeploy.seeds import EVALUATION, listed_numbers
from spikedeploy.trainers.config import require_known
from spikedeploy.trainers.versions import installed_version

OWN, NONE = "own", "none"  # the chip's own bits; no disturbance or fault
_VERSION = 2  # of what a result holds; a higher one makes all results again
_MOST = 100_000  # jobs: planning takes a second or two for each 10,000
# what an episode is computed with, by world; other people's worlds may stand on MuJoCo
_PACKAGES = ("spikedeploy", "numpy", "onnxruntime")
_PHYSICS = {"hexapod": ("mujoco",), "kart": ("pymunk",)}
_OTHER_PHYSICS = ("gymnasium", "mujoco")

T = TypeVar("T")


def _as_tuple(value: object) -> object:
    return tuple(value) if isinstance(value, list | tuple) else (value,)


def _as_group(value: object) -> object:
    """Disturbances or faults of one job: a text, several in a list, or none."""
    return () if value == NONE else _as_tuple(value)


def _folder_name(name: str) -> str:
    if name.startswith(".") or any(letter in name for letter in "/\\\0"):
        raise ValueError("it must be the name of a folder, without slashes")
    return name


Axis = Annotated[tuple[T, ...], BeforeValidator(_as_tuple)]
Whole = Annotated[int, Field(strict=True, ge=0)]
Positive = Annotated[int, Field(strict=True, ge=1)]
Bits = Annotated[Positive | None, BeforeValidator(lambda bits: None if bits == OWN else bits)]
Group = Annotated[tuple[str, ...], BeforeValidator(_as_group)]
_AXES = ("env", "policy", "chip", "bits", "disturb", "fault", "specimen", "seed")


@dataclass(frozen=True)
class SweepGrid:
    """The axes of a sweep, and the setup that its jobs share.

    name: of the sweep; that of its file
    env: short names, ids of gymnasium, or module:Class
    policy: files, run folders, shipped names; none stands for all that are shipped
    chip: of spiking policies; "float" is the float twin; none stands for that which each was
        trained for, or the default
    bits: of the weights on those chips; None is the chip's own number
    disturb: disturbances of the world, those of one job in a tuple
    fault: faults of the chip, likewise
    specimen: which faulty chip
    seed: first seed of each job; (n,)
    episodes: of a job, from its seed on
    setup: without disturbances, faults and specimen
    """

    name: Annotated[str, Field(min_length=1, max_length=100), AfterValidator(_folder_name)]
    env: Axis[str]
    policy: Axis[str] = ()
    chip: Axis[str] = ()
    bits: Axis[Bits] = (None,)
    disturb: Axis[Group] = ((),)
    fault: Axis[Group] = ((),)
    specimen: Axis[Whole] = (0,)
    seed: Axis[Whole] = (EVALUATION,)
    episodes: Positive = 10
    setup: Setup = DEFAULT

    def __post_init__(self) -> None:
        axes = {name: getattr(self, name) for name in _AXES}
        for name, values in axes.items():
            if not values and name not in ("policy", "chip"):
                raise ConfigError(f"{name} is empty, so there is nothing to do. Name one.")
            if twice := [each for each, count in Counter(values).items() if count > 1]:
                raise ConfigError(f"{name}: {twice[0]} is given twice. Give each once.")
        if (jobs := math.prod(len(values) or 1 for values in axes.values())) > _MOST:
            raise ConfigError(f"{jobs:,} jobs; at most {_MOST:,} in a sweep. Split the grid.")
        self.setup.check()
        if (first := min(self.seed)) < EVALUATION:
            raise ConfigError(
                f"seed {first} may have been trained on; evaluation starts at {EVALUATION}"
            )
        for lower, upper in pairwise(sorted(self.seed)):
            if upper - lower < self.episodes:
                raise ConfigError(
                    f"seed: jobs from {lower} and from {upper} on share episodes, as each has "
                    f"{self.episodes}. Leave that many seeds between them, or write a range: "
                    f"seed = '{first}-{max(self.seed) + self.episodes - 1}'."
                )


def read_grid(path: Path) -> SweepGrid:
    """Return the grid in a TOML file; ConfigError names the key that is wrong, or unknown.

    Keys that are no axes are options of a setup, with their names on the command line.
    """
    try:
        found = read_toml(path)
    except OSError as error:
        raise ConfigError(f"cannot read {path}: {error.strerror}") from error
    except (ValueError, RecursionError) as error:
        raise ConfigError(f"{path} is not valid TOML: {error}") from error
    own = {each.name for each in fields(SweepGrid)} - {"setup"}
    options = {f.name.strip("_"): f.name for f in fields(Setup) if f.name not in own}
    try:
        for key in found:
            require_known(key, {*own, *options}, "key")
        seeds, episodes = found.get("seed"), found.get("episodes", SweepGrid.episodes)
        if isinstance(seeds, str) and isinstance(episodes, int) and episodes > 0:
            found["seed"] = listed_numbers("seed", seeds)[::episodes]  # a range, divided into jobs
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}") from error
    setup = Setup.read({options[k]: _repeated(found, k) for k in found.keys() & options}, path)
    axes = {key: value for key, value in found.items() if key in own}
    return validate(SweepGrid, {"name": path.stem, "setup": setup, **axes}, path)


def _repeated(found: dict[str, Any], option: str) -> Any:  # noqa: ANN401
    """Return the value of an option; of one that may be repeated always a list."""
    several = option in ("set", "metric", "energy")
    return _as_tuple(found[option]) if several else found[option]


@plain_dataclass(frozen=True)
class SweepJob:
    """A job: one value of each axis of the grid."""

    env: str
    entry: Entry
    seed: int
    episodes: int

    @cached_property
    def record(self) -> dict[str, Any]:
        """All that the result depends on, as JSON has it."""
        policy, setup = self.entry.candidate, self.entry.setup
        return {
            "env": self.env,
            "policy": policy.name,
            "format": policy.format,
            "sha256": "" if policy.format in BUILT_IN else _sha256(policy.path),
            "chip": self.entry.chip,
            "setup": setup.as_json(),
            "seed": self.seed,
            "episodes": self.episodes,
            "versions": versions_for(self.env),
            "version": _VERSION,
        }

    @cached_property
    def key(self) -> str:
        """SHA-256 of the record, in hexadecimal."""
        text = json.dumps(self.record, sort_keys=True, separators=(",", ":"))
        return hashlib.sha256(text.encode()).hexdigest()

    @property
    def label(self) -> str:
        """`kart-grid · snn · loihi1 · noise:2 · seed 10000`, for messages."""
        setup = self.entry.setup
        specimen = [f"specimen {setup.specimen}"] if setup.fault else []
        parts = [self.env, self.entry.candidate.name, self.entry.chip, *setup.disturb, *setup.fault]
        return " · ".join(part for part in (*parts, *specimen, f"seed {self.seed}") if part)

    @cached_property
    def cell(self) -> str:
        """The key of what jobs have in common that differ in their seeds alone."""
        return replace(self, seed=0).key

    @property
    def undisturbed(self) -> "SweepJob":
        """The job without disturbances and faults."""
        setup = replace(self.entry.setup, disturb=(), fault=(), specimen=0)
        return replace(self, entry=replace(self.entry, setup=setup))


@cache
def _sha256(path: str) -> str:
    return zoo.sha256(Path(path))


def expand(grid: SweepGrid) -> list[SweepJob]:
    """Return all jobs of a grid, each once; ConfigError where an axis has what does not exist.

    They are in the order of the axes, the seed last.
    """
    for texts in grid.fault:
        faults(texts)
    for env, texts in product(grid.env, grid.disturb):
        disturbances(texts, envs.spec(env).world)
    jobs: dict[str, SweepJob] = {}
    for env, candidates in _fitting(grid).items():
        for candidate in candidates:
            for entry, seed in product(_entries(grid, candidate), grid.seed):
                job = SweepJob(env, entry, seed, grid.episodes)
                jobs.setdefault(job.key, job)
    if not jobs:
        raise ConfigError(
            "no job is left: bits and faults are of chips, and no policy runs on one here. Add "
            '"own" to bits, "none" to fault, or a policy that spikes.'
        )
    return list(jobs.values())


def _fitting(grid: SweepGrid) -> dict[str, list[Candidate]]:
    """Return the policies that are made for each environment; each must be for one of them."""
    from spikedeploy.shipping.exported_run import runnable

    named = [find(runnable(name)) for name in grid.policy]
    short = [candidate.name for candidate in named]
    if len(named) > len({(each.name, each.env) for each in named}):
        twice = next(name for name in short if short.count(name) > 1)
        raise ConfigError(f"policy: two are called {twice}. Give one of them another name.")
    found: dict[str, list[Candidate]] = {}
    options = grid.setup.options()
    for env in grid.env:
        shipped = [find(str(path)) for path in zoo.policies(env)] if not named else []
        fits = (None, envs.spec(env).id)
        found[env] = [each for each in [*named, *shipped] if each.env in fits]
        if not found[env]:
            raise ConfigError(f"policy: none is for {env}. Name one, such as {env}/snn or random.")
        world = envs.make(env, **options)
        for candidate in found[env]:
            check_fit(candidate, world)
        world.close()
        if remark := check_repeats(env, options):
            say(remark)
    for each in named:
        if not any(each in many for many in found.values()):
            raise ConfigError(f"policy: {each.name} is for {each.env}, which env does not name")
    return found


def _entries(grid: SweepGrid, candidate: Candidate) -> Iterator[Entry]:
    """Yield a policy on each chip with each setup; what does not spike has no chip or faults."""
    spikes = candidate.kind == "snn"
    chips: tuple[str | None, ...] = (None,)
    if spikes:
        chips = grid.chip or (candidate.chip or DEFAULT_CHIP,)
    for name, bits, disturb, fault, specimen in product(
        chips, grid.bits, grid.disturb, grid.fault, grid.specimen
    ):
        on_chip = name not in (None, FLOAT)
        if fault and not on_chip:
            continue
        place = name if name is None or bits is None or not on_chip else _with_bits(name, bits)
        if on_chip:
            chip(str(place))  # refuses an unknown one
        setup = replace(grid.setup, disturb=disturb, fault=fault, specimen=specimen if fault else 0)
        yield Entry(candidate, place, setup=setup)


def _with_bits(name: str, bits: int) -> str:
    return f"{name}{',' if ':' in name else ':'}weight_bits={bits}"


@cache
def versions_for(env: str) -> dict[str, str | None]:
    """Return package -> version of what computes an episode in an environment, here."""
    packages = (*_PACKAGES, *_PHYSICS.get(envs.spec(env).world, _OTHER_PHYSICS))
    return {package: installed_version(package) for package in packages}
