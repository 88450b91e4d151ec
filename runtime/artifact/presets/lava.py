"""What Lava's processes make of a NIR file, as the NIR paper's import sets them."""

import nir
import numpy as np

from spikedeploy.runtime.artifact.presets.nodes import at_rest, changed, demand, near, stated
from spikedeploy.runtime.artifact.presets.nodes import values as numbers
from spikedeploy.runtime.artifact.presets.preset import Edges, Nodes, Preset
from spikedeploy.runtime.convention import Convention

TOOL = "Lava 0.10.0 (float)"


def _read(nodes: Nodes, edges: Edges, convention: Convention) -> None:
    for name, node in nodes.items():
        if isinstance(node, nir.Affine):
            demand(np.abs(node.bias) <= 1e-8, name, TOOL, "reads no bias of an Affine")
        if isinstance(node, (nir.LIF, nir.CubaLIF)):
            demand(node.v_leak == 0, name, TOOL, "needs v_leak = 0")
        if isinstance(node, nir.LIF):
            # the weight before it becomes dt/tau, without r
            nodes[name] = at_rest(changed(node, r=np.ones(node.r.shape)))
        if isinstance(node, nir.CubaLIF):
            close = near(node.r, numbers(node.tau_mem) / convention.dt)
            demand(close, name, TOOL, "needs r = tau_mem/dt")
            nodes[name] = at_rest(node)


LAVA = Preset(
    tool=TOOL,
    kinds=(nir.Affine, nir.Linear, nir.LIF, nir.CubaLIF),
    convention=stated(TOOL, 1e-4, delay=1),
    options=("dt",),
    reading=_read,
    source="github.com/neuromorphs/NIR paper/nir_to_lava.py; a Dense hears the timestep before",
)
