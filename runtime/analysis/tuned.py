"""A tuned policy as an artifact: the choices of calibration, applied to the network's numbers.

A clip ratio above 1 cuts weights and biases where the chip's largest weight is, and a threshold's
factor multiplies it, so that untuned quantisation of the changed network gives the same integers.
A ratio below 1 leaves headroom, which no weight can express: scales follow the largest.
The integers are compared, so that what is written computes what was measured, or is not written.
"""

from collections.abc import Iterator
from copy import copy
from dataclasses import replace
from typing import Any

import nir
import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.artifact.artifact import Artifact, digest
from spikedeploy.runtime.chips.chip import Chip
from spikedeploy.runtime.chips.layer import Layer
from spikedeploy.runtime.chips.quantisation import UNTUNED, Quantisation, Tuning
from spikedeploy.runtime.compiler.compile import compile_program
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.graph.shapes import CONVOLUTIONS, DENSE

Floats = NDArray[np.float64]

_NUMBERS = ("bias", "voltage_bias", "threshold", "current_decay", "membrane_decay")
# Types of the changed arrays, None their own, and the part of the largest weight at which they are
# cut, of which the first that give the same integers are taken: rounding to the file's own type can
# move one, and where neurons share thresholds a scale may end above its threshold, but not below.
_ATTEMPTS = ((None, 1.0), (np.float64, 1.0), (np.float64, 1 - 2.0**-50))


def tuned_artifact(
    artifact: Artifact, on: Chip, called: str, quantisation: Quantisation
) -> Artifact | None:
    """Return the artifact whose untuned quantisation equals `quantisation` of this one.

    called: name of the chip with its options, for the artifact's description.

    None where no artifact can express it: a ratio below 1, clipped weights that are not those of
    one map onto one layer, numbers that another rounding would move.
    """
    if any(tuning.clip_ratio < 1 for tuning in quantisation.tuned.values()):
        return None
    program = compile_program(artifact, on, quantisation, limits=False)
    said = (
        f"by drift --tune for {called}: {quantisation.describe()}; before that the policy of "
        f"SHA-256 {digest(artifact)}"
    )
    plain = replace(quantisation, tuned={})
    for precision, part in _ATTEMPTS:
        nodes = dict(artifact.graph.nodes)
        for layer in program.layers:
            _tune(nodes, artifact, layer, on, quantisation.tuning_for(layer.name), precision, part)
        graph = nir.NIRGraph(
            nodes,
            list(artifact.graph.edges),
            metadata=dict(artifact.graph.metadata),
            type_check=False,
        )
        found = replace(artifact, graph=graph, tuned=said)
        if _same_integers(program, compile_program(found, on, plain, limits=False)):
            return found
    return None


def _tune(
    nodes: dict[str, nir.NIRNode],
    artifact: Artifact,
    layer: Layer,
    on: Chip,
    tuning: Tuning,
    precision: type[np.float64] | None,
    part: float,
) -> None:
    """Change the nodes of a layer, which was compiled with its tuning."""
    if tuning == UNTUNED:
        return
    threshold = nodes[layer.name].v_threshold
    raised = _as_stored(threshold.astype(np.float64) * tuning.threshold, threshold, precision)
    # built again as a reader makes it: nir gives w_in the type of the thresholds
    nodes[layer.name] = replace(nodes[layer.name], v_threshold=raised)
    if tuning.clip_ratio <= 1:
        return
    # all tuned arithmetics have Loihi's registers: a weight counts 2**mantissa_shift state units
    arithmetic: Any = on.arithmetic
    unit = np.asarray(layer.scale) * (1 << arithmetic.mantissa_shift)
    gain = np.abs(artifact.neurons[layer.name].flat().gain)
    limits = np.full(layer.size, np.inf)
    np.divide(arithmetic.weight_max * unit * part, gain, out=limits, where=gain > 0)
    for name in _maps_into(artifact.graph, layer.name):
        node = copy(nodes[name])
        if layer.size % len(node.weight):
            continue
        each = limits.reshape(len(node.weight), -1).min(axis=1)
        for field in ("weight", "bias"):
            if (values := getattr(node, field, None)) is not None:
                most = each.reshape(-1, *(1,) * (values.ndim - 1))
                clipped = np.clip(values.astype(np.float64), -most, most)
                setattr(node, field, _as_stored(clipped, values, precision))
        nodes[name] = node


def _as_stored(
    changed: Floats, values: NDArray[Any], precision: type[np.float64] | None
) -> NDArray[Any]:
    """Return changed numbers in a precision, or in their own; unchanged ones as they were."""
    if np.array_equal(changed, values):
        return values
    return changed.astype(precision or values.dtype)


def _maps_into(graph: nir.NIRGraph, name: str) -> Iterator[str]:
    """The maps whose weights are those of a layer, and of no other."""
    for source, _ in (edge for edge in graph.edges if edge[1] == name):
        if sum(edge[0] == source for edge in graph.edges) > 1:
            continue
        node = graph.nodes[source]
        if isinstance(node, (*DENSE, *CONVOLUTIONS)):
            yield source
        elif isinstance(node, (nir.Flatten, nir.Delay)):
            yield from _maps_into(graph, source)


def _same_integers(one: Program, other: Program) -> bool:
    return all(
        np.array_equal(mine, its)
        for a, b in zip(one.layers, other.layers, strict=True)
        for mine, its in zip(_integers(a), _integers(b), strict=True)
    )


def _integers(layer: Layer) -> Iterator[NDArray[Any]]:
    yield from (getattr(layer, name) for name in _NUMBERS)
    yield from (synapses.weight for synapses in layer.synapses)
