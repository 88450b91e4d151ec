"""snnTorch: its import of NIR."""

import nir
import numpy as np

from spikedeploy.runtime.artifact.presets.preset import (
    Edges,
    Nodes,
    Preset,
    default_convention,
    float64,
    is_close,
    is_uniform,
    require,
    with_batch_axis,
    with_gain,
    with_parameters,
    with_zero_reset,
)
from spikedeploy.runtime.convention import Convention

TOOL = "snnTorch 1.0.0"


def _translate(nodes: Nodes, edges: Edges, convention: Convention) -> None:
    for name, node in nodes.items():
        if isinstance(node, nir.Flatten):
            nodes[name] = with_batch_axis(node)
        if isinstance(node, nir.IF):
            require(
                False, name, TOOL, "reads IF as a leaky neuron of decay factor 0.9 (its issue 416)"
            )
        if isinstance(node, (nir.LIF, nir.CubaLIF)):
            nodes[name] = _neuron(name, node, convention)


def _neuron(name: str, node: nir.NIRNode, convention: Convention) -> nir.NIRNode:
    """The neuron with a gain of 1; another gain of the file divides the threshold instead."""
    require(node.v_leak == 0, name, TOOL, "needs v_leak = 0")
    if isinstance(node, nir.CubaLIF):
        close = is_close(node.r, float64(node.tau_mem) / convention.dt)
        require(close, name, TOOL, f"needs r = tau_mem/dt, dt being {convention.dt:g} s always")
        scale = float64(node.w_in) * convention.dt / float64(node.tau_syn)
    else:
        scale = float64(node.r) * convention.dt / float64(node.tau)
    threshold = float64(node.v_threshold)
    if not is_close(scale, 1.0).all():
        require(scale > 0, name, TOOL, "needs gains above 0")
        threshold = threshold / scale
    require(is_uniform(np.round(threshold, 12)), name, TOOL, "needs one threshold for all neurons")
    return with_zero_reset(with_parameters(with_gain(node, convention), v_threshold=threshold))


SNNTORCH = Preset(
    tool=TOOL,
    kinds=(
        nir.Affine,
        nir.Linear,
        nir.Conv2d,
        nir.Flatten,
        nir.AvgPool2d,
        nir.IF,
        nir.LIF,
        nir.CubaLIF,
    ),
    convention=default_convention(TOOL, 1e-4),
    options=(),
    translate=_translate,
    source="snntorch 1.0.0, import_nir.py: dt, reset_mechanism and reset_delay are constants there",
)
