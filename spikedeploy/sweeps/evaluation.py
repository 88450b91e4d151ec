"""A job of a sweep, run: a pure function of its specification and the bytes of its policy."""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from spikedeploy import envs
from spikedeploy.comparison.comparison import Comparison, Row
from spikedeploy.comparison.episodes import EpisodeJob, foreign_period, play
from spikedeploy.comparison.lineup import Entry
from spikedeploy.policies.registry import Candidate, find
from spikedeploy.runtime.chips.quantisation import PLAIN, Quantisation
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.faults import faults
from spikedeploy.sweeps.specification import JobSpecification, versions_for


@dataclass(frozen=True)
class SweepJob:
    """What travels to a worker.

    of      what the job is
    policy  bytes of the file; None for a built-in
    """

    of: JobSpecification
    policy: bytes | None


def evaluate_job(job: SweepJob) -> dict[str, Any]:
    """The row of a report, as `run` gives it, and the control steps of each episode."""
    of = job.of
    _check_versions(of)
    entry = Entry(_candidate(of, job.policy), of.place)
    options = {**of.options, **({"disturb": list(of.disturb)} if of.disturb else {})}
    text, seeds = json.dumps(options), range(of.seed, of.seed + of.episodes)
    episodes = [
        play(EpisodeJob(of.env, text, entry.candidate, entry.chip, seed, {}, None, of.metrics))
        for seed in seeds
    ]
    spec, period = envs.spec(of.env), foreign_period(of.env, text)
    rows = [Row(entry, episodes)]
    found = Comparison(spec.id, seeds, rows, (), of.disturb, spec.foreign, period).as_json()[0]
    return {**found, "file": of.policy, "steps": [episode.steps for episode in episodes]}


def _check_versions(of: JobSpecification) -> None:
    """Refuse to compute with other versions than the job names."""
    here: Mapping[str, str | None] = versions_for(of.env)
    for package, version in of.versions.items():
        if here.get(package) != version:
            raise ConfigError(
                f"this worker has {package} {here.get(package)}, the sweep was begun with "
                f"{version}: install the same on all machines"
            )


def _candidate(of: JobSpecification, policy: bytes | None) -> Candidate:
    """The policy, as the job has it on its chip."""
    found = find(of.format if policy is None else str(_file(of, policy)))
    return replace(
        found,
        name=of.policy,
        limits=of.limits,
        quantisation=Quantisation(**of.quantisation) if of.quantisation else PLAIN,
        faults=faults(of.fault, of.specimen),
    )


def _file(of: JobSpecification, policy: bytes) -> Path:
    """The policy's file on this machine, written where it is not there yet."""
    if (found := hashlib.sha256(policy).hexdigest()) != of.sha256:
        raise ConfigError(f"{of.policy}: its bytes arrived damaged, with SHA-256 {found}")
    file = Path(_folder().name) / f"{of.sha256}{of.format}"
    if not file.is_file():
        file.write_bytes(policy)
    return file


@cache
def _folder() -> TemporaryDirectory[str]:
    """A folder for policies, as long as this process lives."""
    return TemporaryDirectory(prefix="spikedeploy-")
