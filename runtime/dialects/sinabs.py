"""Sinabs: its import of NIR, and what its export means.

The export is read in its source and worked out by hand.
"""

import nir

from spikedeploy.runtime.convention import Convention, Floor
from spikedeploy.runtime.dialects.dialect import (
    Assumption,
    Nodes,
    Preset,
    Writer,
    are_integrators,
    require,
    with_gain,
    with_zero_reset,
    without_padding,
)

_TOOL = "sinabs 3.1.3"
_KINDS = (
    nir.Affine, nir.Conv1d, nir.Conv2d, nir.SumPool2d, nir.Flatten, nir.LI, nir.IF, nir.LIF,
)  # fmt: skip


def _convention(nodes: Nodes) -> Convention:
    """Time constants are in timesteps; only integrators have a floor."""
    mixture = "floors the membranes of IF and not those of LIF, and the graph has both"
    floor: Floor = "threshold" if are_integrators(nodes, mixture) else "none"
    return Convention(1.0, "subtract", "exponential", spikes="many", floor=floor)


def _read(name: str, node: nir.NIRNode, convention: Convention) -> nir.NIRNode:
    if isinstance(node, nir.SumPool2d):
        return without_padding(node)
    if not isinstance(node, (nir.IF, nir.LIF, nir.LI)):
        return node
    if not isinstance(node, nir.IF):
        require(node.v_leak == 0, name, "needs v_leak = 0")
    # norm_input is False: the input has gain 1, and r is ignored
    unit = with_gain(node, convention)
    if isinstance(node, nir.LI):
        require(node.r == 1, name, "needs r = 1")
        return unit
    return with_zero_reset(unit)


PRESET = Preset(
    tool=_TOOL,
    kinds=_KINDS,
    convention=_convention,
    remark="tau in timesteps",
    translate=_read,
    source="sinabs 3.1.3, nir.py, layers/functional/lif.py and activation/spike_generation.py",
)


def _as_meant(name: str, node: nir.NIRNode, convention: Convention) -> nir.NIRNode:
    if isinstance(node, (nir.LIF, nir.LI, nir.IF)):
        require(node.r == 1, name, "writes r = 1")
    if isinstance(node, (nir.LIF, nir.LI)):
        require(node.v_leak == 0, name, "writes v_leak = 0")
    # norm_input is False by default in ExpLeak, and True in LIF, where r = 1 is right
    return with_gain(node, convention) if isinstance(node, nir.LI) else node


WRITER = Writer(
    tool=_TOOL,
    kinds=_KINDS,
    timestep=lambda name, node: 1.0,
    contradiction=f": {_TOOL} counts its time constants in timesteps, and writes them so",
    translate=_as_meant,
    source="sinabs 3.1.3, nir.py, layers/lif.py, layers/iaf.py and layers/exp_leak.py",
    fixed={"integrator": "exponential"},
    open={
        "spikes": Assumption(
            ("many", "reached"),
            "as many spikes as fit (MultiSpike; --spikes reached for SingleSpike)",
        ),
        "reset": Assumption(
            ("subtract", "zero"),
            "reset by subtraction (MembraneSubtract; --reset zero for MembraneReset)",
        ),
        "floor": Assumption(
            ("none", "threshold"),
            "no lowest membrane (--floor threshold for min_v_mem = -spike_threshold)",
        ),
    },
    always=("norm_input and tau_syn as by default",),
)
