"""Drift of a chip from the float twin, with or without calibration before it, and its inputs.

Inputs are a raster file, random spikes, or the observations of a policy, encoded.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
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
from spikedeploy.runtime.analysis.calibration import tune_to_float, with_calibrated_headroom
from spikedeploy.runtime.analysis.drift import Drift
from spikedeploy.runtime.analysis.drift import drift as measured
from spikedeploy.runtime.analysis.tuned import tuned_artifact
from spikedeploy.runtime.artifact.artifact import Artifact
from spikedeploy.runtime.chips.chip import Chip
from spikedeploy.runtime.chips.quantisation import PLAIN, UNTUNED, Quantisation
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

    def halves(self) -> "tuple[DriftInputs, DriftInputs]":
        """Every other inference, for calibration, and the rest; a single one is both.

        Where states are kept, every other episode: an inference means nothing without those before.
        """
        pieces = np.split(self.raster, np.cumsum(self.episodes or [1] * len(self.raster))[:-1])
        if len(pieces) < 2:
            return self, self
        halves = []
        for each in (pieces[::2], pieces[1::2]):
            part, lengths = np.concatenate(each), tuple(map(len, each)) if self.episodes else ()
            halves.append(DriftInputs(part, f"{self.source}, {len(part)} of them", lengths))
        return halves[0], halves[1]


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
    player = open_policy(candidate, FLOAT, world)
    played = [rollout(world, player, seed) for seed in seeds]
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
    calibrated: inputs of the calibration, in words; empty without one
    drift: the measurement
    tuned: the policy as tuning changed it; None where it was not asked for, or nothing helped
    """

    policy: str
    convention: Convention
    inputs: str
    calibrated: str
    drift: Drift
    tuned: Artifact | None = None

    def as_json(self) -> dict[str, Any]:
        """The fields as plain data."""
        return {
            "policy": self.policy,
            "convention": self.convention.to_record(),
            "inputs": self.inputs,
            "calibrated": self.calibrated or None,
            "tuned": self.tuned.tuned if self.tuned else None,
            **self.drift.as_json(),
        }


def drift_report(
    policy: str,
    artifact: Artifact,
    on: Chip,
    inputs: DriftInputs,
    headroom: bool = False,
    tune: bool = False,
    for_file: str = "",
    tau: float = TAU,
    limits: bool = True,
    quantisation: Quantisation = PLAIN,
) -> DriftReport:
    """Calibrate on half of the inputs and measure on the rest; without calibration on all.

    headroom: choose scales at which nothing overflows on the calibration inputs
    tune: choose clipping and thresholds that bring each layer nearest to the float twin
    for_file: the chip with its options, as the tuned policy is to name it: tune by nothing but what
        a policy of its own can say, and make that; empty tunes without
    tau: [timesteps] time constant of the van Rossum distance
    limits: refuse what breaks a design rule of the chip
    """
    calibrated, tuned = "", None
    if headroom and for_file:
        raise ConfigError(
            "--calibrate chooses scales below the largest, which no file can say. Leave it out, or "
            "--tuned."
        )
    if headroom or tune:
        first, inputs = inputs.halves()
        calibrated = first.source
        if tune:
            write = partial(tuned_artifact, artifact, on, for_file) if for_file else None
            quantisation = tune_to_float(
                artifact, on, first.raster, quantisation, tau, first.episodes, write
            )
            if write and any(each != UNTUNED for each in quantisation.tuned.values()):
                tuned = write(quantisation)
        if headroom:
            quantisation = with_calibrated_headroom(
                artifact, on, first.raster, quantisation, first.episodes
            )
    found = measured(artifact, on, inputs.raster, quantisation, tau, limits, inputs.episodes)
    return DriftReport(policy, artifact.convention, inputs.source, calibrated, found, tuned)
