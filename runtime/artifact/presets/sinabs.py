"""sinabs: its import of NIR."""

import nir
import numpy as np

from spikedeploy.runtime.artifact.presets.preset import (
    Edges,
    Nodes,
    Preset,
    require,
    with_gain,
    with_parameters,
    with_zero_reset,
)
from spikedeploy.runtime.convention import Convention, Floor

TOOL = "sinabs 3.1.3"


def _convention(nodes: Nodes, _: float | None) -> Convention:
    """Time constants are in timesteps; only integrators have a floor."""
    kinds = {type(node) for node in nodes.values()} & {nir.IF, nir.LIF}
    first = next((name for name, node in sorted(nodes.items()) if isinstance(node, nir.IF)), "")
    require(
        len(kinds) < 2,
        first,
        TOOL,
        "floors the membranes of IF and not those of LIF, and the graph has both",
    )
    source = f"as {TOOL} reads it: tau in timesteps"
    floor: Floor = "threshold" if nir.IF in kinds else "none"
    return Convention(1.0, "subtract", "exponential", source=source, spikes="many", floor=floor)


def _translate(nodes: Nodes, edges: Edges, convention: Convention) -> None:
    for name, node in nodes.items():
        if isinstance(node, nir.SumPool2d):
            nodes[name] = with_parameters(node, padding=np.zeros(2, int))
        if isinstance(node, (nir.LIF, nir.LI)):
            require(node.v_leak == 0, name, TOOL, "needs v_leak = 0")
        if isinstance(node, nir.LI):
            require(node.r == 1, name, TOOL, "needs r = 1")
        if isinstance(node, (nir.IF, nir.LIF, nir.LI)):
            # norm_input is False: the input has gain 1, and r is ignored
            unit = with_gain(node, convention)
            nodes[name] = unit if isinstance(node, nir.LI) else with_zero_reset(unit)


SINABS = Preset(
    tool=TOOL,
    kinds=(
        nir.Affine,
        nir.Conv1d,
        nir.Conv2d,
        nir.SumPool2d,
        nir.Flatten,
        nir.LI,
        nir.IF,
        nir.LIF,
    ),
    convention=_convention,
    options=(),
    translate=_translate,
    source="sinabs 3.1.3, nir.py, layers/functional/lif.py and activation/spike_generation.py",
)
