"""Lava: its processes as the NIR paper's import configures them."""

import nir
import numpy as np

from spikedeploy.runtime.artifact.presets.preset import (
    Edges,
    Nodes,
    Preset,
    default_convention,
    float64,
    is_close,
    require,
    with_parameters,
    with_zero_reset,
)
from spikedeploy.runtime.convention import Convention

TOOL = "Lava 0.10.0 (float)"


def _translate(nodes: Nodes, edges: Edges, convention: Convention) -> None:
    for name, node in nodes.items():
        if isinstance(node, nir.Affine):
            require(np.abs(node.bias) <= 1e-8, name, TOOL, "reads no bias of an Affine")
        if isinstance(node, (nir.LIF, nir.CubaLIF)):
            require(node.v_leak == 0, name, TOOL, "needs v_leak = 0")
        if isinstance(node, nir.LIF):
            # the import scales the weights before it by dt/tau and ignores r
            nodes[name] = with_zero_reset(with_parameters(node, r=np.ones(node.r.shape)))
        if isinstance(node, nir.CubaLIF):
            close = is_close(node.r, float64(node.tau_mem) / convention.dt)
            require(close, name, TOOL, "needs r = tau_mem/dt")
            nodes[name] = with_zero_reset(node)


LAVA = Preset(
    tool=TOOL,
    kinds=(nir.Affine, nir.Linear, nir.LIF, nir.CubaLIF),
    convention=default_convention(TOOL, 1e-4, delay=1),
    options=("dt",),
    translate=_translate,
    source="github.com/neuromorphs/NIR paper/nir_to_lava.py; a Dense has a delay of one timestep",
)
