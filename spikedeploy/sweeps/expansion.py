"""The grid of a sweep as jobs: combinations that mean something, each once, and the policies."""

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from itertools import product
from pathlib import Path
from typing import Any

from spikedeploy import envs, zoo
from spikedeploy.envs.disturbances import disturbances
from spikedeploy.make_env import make_env
from spikedeploy.policies.registry import BUILT_IN, FLOAT, Candidate, check_fit, find
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.faults import faults
from spikedeploy.sweeps.grid import SweepGrid
from spikedeploy.sweeps.specification import JobSpecification, versions_for


@dataclass(frozen=True)
class SweepPlan:
    """The jobs of a sweep.

    jobs      in the order of the axes, the seed last
    policies  sha256 -> bytes of the file; a worker may have another disk
    """

    jobs: list[JobSpecification]
    policies: dict[str, bytes]


def expand(grid: SweepGrid) -> SweepPlan:
    """All jobs of a grid; ConfigError where an axis has something that does not exist."""
    _check(grid)
    policies: dict[str, bytes] = {}
    jobs: dict[str, JobSpecification] = {}
    for env, candidates in _fitting(grid).items():
        for candidate in candidates:
            policy = _policy_fields(candidate, policies)
            for job in _jobs(grid, env, candidate.kind == "snn", policy):
                jobs.setdefault(job.key, job)
    return SweepPlan(list(jobs.values()), policies)


def _check(grid: SweepGrid) -> None:
    """Refuse unknown chips, bits, disturbances and faults before a job is run."""
    for name, bits in product(grid.chip, grid.bits):
        if name != FLOAT:
            chip(name, **({} if bits is None else {"weight_bits": bits}))
    for texts in grid.fault:
        faults(texts)
    for env, texts in product(grid.env, grid.disturb):
        disturbances(texts, envs.spec(env).world)


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
        id_ = envs.spec(env).id
        shipped = [find(str(path)) for path in zoo.policies(env)] if not named else []
        found[env] = [each for each in [*named, *shipped] if each.env in (None, id_)]
        if not found[env]:
            raise ConfigError(f"policy: none is for {env}. Name one, such as {env}/snn or random.")
        _check_fit(grid, env, found[env])
    for each in named:
        if not any(each in many for many in found.values()):
            raise ConfigError(f"policy: {each.name} is for {each.env}, which env does not name")
    return found


def _check_fit(grid: SweepGrid, env: str, candidates: list[Candidate]) -> None:
    world = make_env(env, grid.options)
    for candidate in candidates:
        check_fit(candidate, world)
    world.close()


def _policy_fields(candidate: Candidate, policies: dict[str, bytes]) -> dict[str, Any]:
    """The fields of a job that say which policy; the bytes of its file are kept."""
    fields = {"policy": candidate.name, "format": candidate.format, "sha256": ""}
    if candidate.format in BUILT_IN:
        return fields
    path = Path(candidate.path)
    sha256 = zoo.sha256(path)
    policies[sha256] = path.read_bytes()
    return {**fields, "sha256": sha256}


def _jobs(
    grid: SweepGrid, env: str, spikes: bool, policy: dict[str, Any]
) -> Iterator[JobSpecification]:
    """The jobs of a policy; those that differ in what it does not have are alike."""
    quantisation = {
        name: each for name, each in asdict(grid.quantisation).items() if name != "tuned"
    }
    axes = (grid.chip, grid.bits, grid.disturb, grid.fault, grid.specimen, grid.seed)
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
