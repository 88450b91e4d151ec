"""What Norse's import makes of a NIR file."""

import nir
import numpy as np

from spikedeploy.runtime.artifact.presets.nodes import (
    at_rest,
    batch_counted,
    changed,
    demand,
    stated,
)
from spikedeploy.runtime.artifact.presets.preset import Edges, Nodes, Preset
from spikedeploy.runtime.convention import Convention

TOOL = "Norse 1.1.0"


def _read(nodes: Nodes, edges: Edges, convention: Convention) -> None:
    for name, node in nodes.items():
        if isinstance(node, nir.Flatten):
            nodes[name] = batch_counted(node)
        if isinstance(node, nir.SumPool2d):
            nodes[name] = changed(node, padding=np.zeros(2, int))
        if isinstance(node, (nir.IF, nir.LIF)):
            demand(convention.reset == "zero", name, TOOL, "subtracts after spikes of CubaLIF only")
            # r is left out, with a warning; an IF adds its input whatever dt
            r = np.full(node.r.shape, 1 / convention.dt if isinstance(node, nir.IF) else 1.0)
            nodes[name] = at_rest(changed(node, r=r))
        if isinstance(node, nir.CubaLIF):
            demand(node.v_leak == 0, name, TOOL, "would add v_leak to the synapse as well")
            nodes[name] = at_rest(node)


NORSE = Preset(
    tool=TOOL,
    kinds=(
        nir.Affine,
        nir.Linear,
        nir.Conv2d,
        nir.Flatten,
        nir.SumPool2d,
        nir.IF,
        nir.LIF,
        nir.CubaLIF,
    ),
    convention=stated(TOOL, 1e-3),
    options=("dt", "reset"),
    reading=_read,
    source="norse 1.1.0, torch/utils/import_nir.py and torch/functional/lif_box.py",
)
