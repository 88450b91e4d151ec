"""Calibration: scales and thresholds that are chosen on recorded inputs.

Layers are calibrated in the order of the spikes, so that each is judged on the presynaptic spikes
that it will have on the chip. A choice made on one recording proves nothing about others: measure
on a second one.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.analysis.activity import TAU, activity, mean_distance, trains_of
from spikedeploy.runtime.artifact.artifact import Artifact
from spikedeploy.runtime.chips.chip import Chip
from spikedeploy.runtime.chips.quantisation import PLAIN, Quantisation, Tuning
from spikedeploy.runtime.compiler.compile import compile_program
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.errors import RuleError

Raster = NDArray[np.uint8]

# what tuning tries; no change comes first, and so wins among equals. Clipping pays where a few
# weights are much larger than the others.
_CLIP_RATIOS = (1.0, 0.8, 0.9, 1.15, 1.3, 1.5, 1.75, 2.0, 2.5, 3.0)
_THRESHOLDS = (1.0, 0.8, 0.85, 0.9, 0.95, 0.975, 1.025, 1.05, 1.1, 1.15, 1.2)

# smallest part of the scale at which headroom is still looked for, and how near to the largest
_LEAST = 1e-5
_NEAR = 1.02


def with_calibrated_headroom(
    artifact: Artifact,
    on: Chip,
    raster: Raster,
    quantisation: Quantisation = PLAIN,
    episodes: Sequence[int] = (),
) -> Quantisation:
    """The largest scales at which no number overflows on the raster (B, T, M).

    episodes: as in `drift`.
    """

    def lost(tried: Quantisation) -> list[str]:
        program = compile_program(artifact, on, tried, limits=False)
        seen = activity(artifact, program, raster, episodes)
        return [name for name, count in seen.saturations.items() if count]

    for name in _layers(artifact, on, quantisation):
        quantisation = _with_headroom(lost, quantisation, name)
    over = lost(quantisation)
    if over:
        raise RuleError(
            f"layer {over[0]!r}: its numbers overflow on these inputs at every scale tried, since "
            "feedback drives them. Make the loop weaker."
        )
    return quantisation


def tune_to_float(
    artifact: Artifact,
    on: Chip,
    raster: Raster,
    quantisation: Quantisation = PLAIN,
    tau: float = TAU,
    episodes: Sequence[int] = (),
    possible: Callable[[Quantisation], object] | None = None,
) -> Quantisation:
    """The clip ratio, then the factor of thresholds, that bring each layer nearest to float.

    raster: (B, T, M).
    tau: [timesteps] of the distance of van Rossum, which is minimised.
    episodes: as in `drift`.
    possible: predicate; candidates that do not satisfy it are left out.
    """
    twin, trains = activity(artifact, None, raster, episodes), trains_of(artifact, raster, episodes)

    def distance(name: str, tuning: Tuning) -> float:
        tried = _with(quantisation, name, tuning)
        try:
            program = compile_program(artifact, on, tried, limits=False)
            if possible is not None and not possible(tried):
                return np.inf
        except RuleError:  # a scale at which a threshold or all weights vanish
            return np.inf
        seen = activity(artifact, _up_to(program, name), raster, episodes)
        return mean_distance(twin.spikes[name], seen.spikes[name], tau, trains)

    for name in _layers(artifact, on, quantisation):
        if name not in twin.spikes:  # a readout: there are no spikes to bring nearer
            continue
        old = quantisation.tuning_for(name)
        ratios = [replace(old, clip_ratio=old.clip_ratio * ratio) for ratio in _CLIP_RATIOS]
        best = min(ratios, key=lambda each: distance(name, each))
        factors = [replace(best, threshold=old.threshold * factor) for factor in _THRESHOLDS]
        best = min(factors, key=lambda each: distance(name, each))
        quantisation = _with(quantisation, name, best)
    return quantisation


def _layers(artifact: Artifact, on: Chip, quantisation: Quantisation) -> list[str]:
    if "tuned" not in on.arithmetic.choices:
        raise RuleError(
            f"{on.name}: calibration chooses scales of Loihi's arithmetic, which it does not have. "
            "Leave it out."
        )
    program = compile_program(artifact, on, quantisation, limits=False)
    return [layer.name for layer in program.layers]


def _with_headroom(
    overflowing: Callable[[Quantisation], list[str]], quantisation: Quantisation, name: str
) -> Quantisation:
    """The quantisation with the largest clip ratio of a layer at which it does not overflow."""

    def fits(ratio: float) -> bool:
        return name not in overflowing(clipped(ratio))

    def clipped(ratio: float) -> Quantisation:
        return _with(quantisation, name, replace(old, clip_ratio=ratio))

    old = quantisation.tuning_for(name)
    low = high = old.clip_ratio
    while not fits(low):
        high, low = low, low / 2
        if low < _LEAST * old.clip_ratio:
            return quantisation
    while high / low > _NEAR:
        middle = (low * high) ** 0.5
        low, high = (middle, high) if fits(middle) else (low, middle)
    return quantisation if low == old.clip_ratio else clipped(low)


def _up_to(program: Program, name: str) -> Program:
    """Return the program up to a layer; later ones cost time and change nothing."""
    if not program.feed_forward:
        return program
    place = [layer.name for layer in program.layers].index(name)
    layers = program.layers[: place + 1]
    return replace(program, layers=layers, output=name, readout=None, host_outputs=(), host=())


def _with(quantisation: Quantisation, layer: str, tuning: Tuning) -> Quantisation:
    return replace(quantisation, tuned={**quantisation.tuned, layer: tuning})
