"""Norse: its import of NIR."""

import nir
import numpy as np

from spikedeploy.runtime.artifact.presets.preset import (
    Edges,
    Nodes,
    Preset,
    default_convention,
    require,
    with_batch_axis,
    with_parameters,
    with_zero_reset,
)
from spikedeploy.runtime.convention import Convention

TOOL = "Norse 1.1.0"


def _translate(nodes: Nodes, edges: Edges, convention: Convention) -> None:
    for name, node in nodes.items():
        if isinstance(node, nir.Flatten):
            nodes[name] = with_batch_axis(node)
        if isinstance(node, nir.SumPool2d):
            nodes[name] = with_parameters(node, padding=np.zeros(2, int))
        if isinstance(node, (nir.IF, nir.LIF)):
            require(
                convention.reset == "zero", name, TOOL, "subtracts after spikes of CubaLIF only"
            )
            # it ignores r, with a warning; an IF adds its input whatever dt is
            r = np.full(node.r.shape, 1 / convention.dt if isinstance(node, nir.IF) else 1.0)
            nodes[name] = with_zero_reset(with_parameters(node, r=r))
        if isinstance(node, nir.CubaLIF):
            require(node.v_leak == 0, name, TOOL, "would add v_leak to the synapse as well")
            nodes[name] = with_zero_reset(node)


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
    convention=default_convention(TOOL, 1e-3),
    options=("dt", "reset"),
    translate=_translate,
    source="norse 1.1.0, torch/utils/import_nir.py and torch/functional/lif_box.py",
)
