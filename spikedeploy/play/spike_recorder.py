"""Spikes of a policy on the observations of a recorded episode."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spikedeploy.policies.registry import Candidate
from spikedeploy.runtime.artifact.artifact import load
from spikedeploy.runtime.emulator.network import chip_called, running
from spikedeploy.runtime.errors import ConfigError

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class InferenceTrace:
    """S inferences of T timesteps each.

    rasters  "input" and every spiking layer -> (S, T, N) uint8
    scores   (S, act) mean readout, before an action is made of it
    """

    rasters: Mapping[str, NDArray[np.uint8]]
    scores: Floats


class SpikeRecorder:
    """A spiking policy, on a chip or in float, whose spikes are recorded.

    name  for people
    """

    def __init__(self, candidate: Candidate, chip: str) -> None:
        if candidate.format != ".nir":
            raise ConfigError(
                f"{candidate.path} shows no spikes: give a .nir file, which `export` writes"
            )
        self.name = f"{candidate.name} on {chip}"
        artifact = load(candidate.path)
        if artifact.codec is None:
            raise ConfigError(f"{candidate.path} has no codec, so observations become no spikes")
        self._codec = artifact.codec
        self._graded = frozenset(artifact.sigma_delta)
        self._network = running(artifact, chip_called(chip), "none", trace=True)

    def record(self, observations: Floats, seed: int) -> InferenceTrace:
        """One inference for each observation (S, obs), in their order."""
        self._network.reset()
        state = self._codec.encoder.start(max(seed, 0))
        rasters: dict[str, list[NDArray[np.uint8]]] = {}
        scores = []
        for observation in observations:
            spikes = self._codec.encode(observation[None], state)
            scores.append(self._codec.scores(self._network.infer(spikes))[0])
            for name, raster in {"input": spikes, **self._network.spikes}.items():
                # a graded spike is shown as one
                shown = (raster != 0).astype(np.uint8) if name in self._graded else raster
                rasters.setdefault(name, []).append(shown[0])
        return InferenceTrace(
            {name: np.stack(rows) for name, rows in rasters.items()}, np.stack(scores)
        )
