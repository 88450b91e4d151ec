"""What sinabs' import makes of a NIR file."""

import nir
import numpy as np

from spikedeploy.runtime.artifact.presets.nodes import at_rest, changed, demand, with_gain
from spikedeploy.runtime.artifact.presets.preset import Edges, Nodes, Preset
from spikedeploy.runtime.convention import Convention, Floor

TOOL = "sinabs 3.1.3"


def _convention(nodes: Nodes, _: float | None) -> Convention:
    """Time constants count timesteps; only integrators have a floor."""
    kinds = {type(node) for node in nodes.values()} & {nir.IF, nir.LIF}
    first = next((name for name, node in sorted(nodes.items()) if isinstance(node, nir.IF)), "")
    demand(len(kinds) < 2, first, TOOL, "floors the membranes of IF and not those of LIF, and both")
    source = f"as {TOOL} reads it: tau in timesteps"
    floor: Floor = "threshold" if nir.IF in kinds else "none"
    return Convention(1.0, "subtract", "exponential", source=source, spikes="many", floor=floor)


def _read(nodes: Nodes, edges: Edges, convention: Convention) -> None:
    for name, node in nodes.items():
        if isinstance(node, nir.SumPool2d):
            nodes[name] = changed(node, padding=np.zeros(2, int))
        if isinstance(node, (nir.LIF, nir.LI)):
            demand(node.v_leak == 0, name, TOOL, "needs v_leak = 0")
        if isinstance(node, nir.LI):
            demand(node.r == 1, name, TOOL, "needs r = 1")
        if isinstance(node, (nir.IF, nir.LIF, nir.LI)):
            # norm_input is False: the input comes in as it is, and r is left out
            unit = with_gain(node, convention)
            nodes[name] = unit if isinstance(node, nir.LI) else at_rest(unit)


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
    reading=_read,
    source="sinabs 3.1.3, nir.py, layers/functional/lif.py and activation/spike_generation.py",
)
