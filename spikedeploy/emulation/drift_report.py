"""Drift of a chip from the float twin, and its inputs.

Inputs are a raster file, random spikes, or the observations of a policy, encoded.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikedeploy import envs
from spikedeploy.emulation.rasters import in_batch, read_rasters
from spikedeploy.envs.rollout import rollout
from spikedeploy.policies.registry import FLOAT, Candidate, confirm, find, open_policy
from spikedeploy.runtime.analysis.activity import TAU
from spikedeploy.runtime.analysis.drift import Drift
from spikedeploy.runtime.analysis.drift import drift as measured
from spikedeploy.runtime.artifact.artifact import Artifact
from spikedeploy.runtime.chips.chip import Chip
from spikedeploy.runtime.chips.quantisation import PLAIN, Quantisation
from spikedeploy.runtime.codec.codec import GIVE_CODEC
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.graph.ports import by_port, ports

Raster = NDArray[np.uint8]


@dataclass(frozen=True, eq=False)
class DriftInputs:
    """Input spikes of B inferences.

    raster: (B, T, M)
    source: where they come from, in words
    episodes: inferences of each episode where states are kept from one to the next, else empty
    """

    raster: Raster
    source: str
    episodes: tuple[int, ...] = ()


def choose_inputs(
    artifact: Artifact,
    path: Path,
    raster: Path | None,
    random: float | None,
    env: str | None,
    seeds: Sequence[int],
    steps: int,
    options: Mapping[str, Any] = MappingProxyType({}),
) -> DriftInputs:
    """Inputs from a raster file, or random at a rate, or else `observed_inputs`."""
    if len(artifact.graph.inputs) > 1:
        raise ConfigError(
            f"the network has the inputs {', '.join(sorted(artifact.graph.inputs))}; only networks "
            "with one can be compared with their float twins. Play it with emulate, in float and "
            "on the chip."
        )
    if raster is not None:
        (rows,) = by_port(ports(artifact.graph.inputs), in_batch(read_rasters(raster))).values()
        return DriftInputs(rows.reshape(*rows.shape[:2], -1), str(raster))
    if random is not None:
        return random_inputs(artifact, random, steps, seeds[0])
    if artifact.codec is None:
        raise ConfigError(
            f"{path} has no codec (observation to spikes), so it cannot be played: give a raster "
            f"with --input, or draw spikes with --random RATE. Or {GIVE_CODEC[0].lower()}"
            f"{GIVE_CODEC[1:]}"
        )
    return observed_inputs(artifact, find(str(path)), env, seeds, steps, options)


def random_inputs(artifact: Artifact, rate: float, timesteps: int, seed: int) -> DriftInputs:
    """Independent spikes at this rate [1/timestep], as one inference."""
    (node,) = artifact.graph.inputs.values()
    width = int(np.prod(node.input_type["input"]))
    raster = np.random.default_rng(seed).random((1, timesteps, width)) < rate
    return DriftInputs(raster.astype(np.uint8), f"spikes drawn at a rate of {rate:g}, seed {seed}")


def observed_inputs(
    artifact: Artifact,
    candidate: Candidate,
    env: str | None,
    seeds: Sequence[int],
    steps: int,
    options: Mapping[str, Any] = MappingProxyType({}),
) -> DriftInputs:
    """Encoded observations of episodes that the float twin of a policy plays.

    env: short name or id; None takes the one that the policy was made for
    seeds: seeds of the episodes that it plays
    steps: control steps that are used: the first ones of each episode where states are kept from
        one to the next, else spread evenly over the episodes
    options: options of the environment
    """
    where = env or candidate.env
    if artifact.codec is None or where is None:
        raise ConfigError(
            f"{candidate.path} does not say for which environment: give --env, or a raster with "
            "--input"
        )
    confirm(where, env, str(candidate.path))
    world = envs.make(where, **options)
    controller = open_policy(candidate, FLOAT, world)
    played = [rollout(world, controller, seed) for seed in seeds]
    world.close()
    encoded = [artifact.codec.encode_episode(p.observation[:-1], p.seed) for p in played]
    kept, all_ = artifact.convention.state == "kept", sum(map(len, encoded))
    if kept:
        share, more = divmod(steps, len(encoded))
        begun = [rows[: share + (place < more)] for place, rows in enumerate(encoded)]
        used = [rows for rows in begun if len(rows)]
    else:
        chosen = np.linspace(0, all_ - 1, min(steps, all_)).round().astype(int)
        used = [np.concatenate(encoded)[chosen]]
    raster, last = np.concatenate(used), f" to {seeds[-1]}" if len(seeds) > 1 else ""
    source = (
        f"{len(raster)} of {all_} control steps of the float twin in {where}, "
        f"seed{'s' * bool(last)} {seeds[0]}{last}"
    )
    return DriftInputs(raster, source, tuple(map(len, used)) if kept else ())


@dataclass(frozen=True)
class DriftReport:
    """A drift, and what it was measured on.

    policy: as the user named it
    convention: convention of the file
    inputs: where they come from
    drift: the measurement
    """

    policy: str
    convention: Convention
    inputs: str
    drift: Drift

    def as_json(self) -> dict[str, Any]:
        """The fields as plain data."""
        return {
            "policy": self.policy,
            "convention": self.convention.to_record(),
            "inputs": self.inputs,
            **self.drift.as_json(),
        }


def drift_report(
    policy: str,
    artifact: Artifact,
    on: Chip,
    inputs: DriftInputs,
    tau: float = TAU,
    limits: bool = True,
    quantisation: Quantisation = PLAIN,
) -> DriftReport:
    """Measure the drift on the inputs.

    tau: [timesteps] time constant of the van Rossum distance
    limits: refuse what breaks a design rule of the chip
    """
    found = measured(artifact, on, inputs.raster, quantisation, tau, limits, inputs.episodes)
    return DriftReport(policy, artifact.convention, inputs.source, found)
