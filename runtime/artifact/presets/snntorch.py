"""What snnTorch's import makes of a NIR file."""

import nir
import numpy as np

from spikedeploy.runtime.artifact.presets.nodes import (
    at_rest,
    batch_counted,
    changed,
    demand,
    near,
    same,
    stated,
    with_gain,
)
from spikedeploy.runtime.artifact.presets.nodes import values as numbers
from spikedeploy.runtime.artifact.presets.preset import Edges, Nodes, Preset
from spikedeploy.runtime.convention import Convention

TOOL = "snnTorch 1.0.0"


def _read(nodes: Nodes, edges: Edges, convention: Convention) -> None:
    for name, node in nodes.items():
        if isinstance(node, nir.Flatten):
            nodes[name] = batch_counted(node)
        if isinstance(node, nir.IF):
            demand(False, name, TOOL, "reads IF as a leaky neuron of decay 0.9 (its issue 416)")
        if isinstance(node, (nir.LIF, nir.CubaLIF)):
            nodes[name] = _neuron(name, node, convention)


def _neuron(name: str, node: nir.NIRNode, convention: Convention) -> nir.NIRNode:
    """A gain of 1; what the file says otherwise is put into the threshold instead."""
    demand(node.v_leak == 0, name, TOOL, "needs v_leak = 0")
    if isinstance(node, nir.CubaLIF):
        close = near(node.r, numbers(node.tau_mem) / convention.dt)
        demand(close, name, TOOL, f"needs r = tau_mem/dt, dt being {convention.dt:g} s always")
        scale = numbers(node.w_in) * convention.dt / numbers(node.tau_syn)
    else:
        scale = numbers(node.r) * convention.dt / numbers(node.tau)
    threshold = numbers(node.v_threshold)
    if not near(scale, 1.0).all():
        demand(scale > 0, name, TOOL, "needs gains above 0")
        threshold = threshold / scale
    demand(same(np.round(threshold, 12)), name, TOOL, "needs one threshold for all neurons")
    return at_rest(changed(with_gain(node, convention), v_threshold=threshold))


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
    convention=stated(TOOL, 1e-4),
    options=(),
    reading=_read,
    source="snntorch 1.0.0, import_nir.py: dt, reset_mechanism and reset_delay are constants there",
)
