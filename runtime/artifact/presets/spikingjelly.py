"""What SpikingJelly's import makes of a NIR file."""

import nir

from spikedeploy.runtime.artifact.presets.nodes import demand, near, same, stated
from spikedeploy.runtime.artifact.presets.nodes import values as numbers
from spikedeploy.runtime.artifact.presets.preset import Edges, Nodes, Preset
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.graph.neurons import SPIKING

TOOL = "SpikingJelly 2.0.0"


def _read(nodes: Nodes, edges: Edges, convention: Convention) -> None:
    for name, node in nodes.items():
        if isinstance(node, (nir.Conv1d, nir.Conv2d)):
            demand(node.groups == 1, name, TOOL, "reads no grouped convolution")
        if isinstance(node, SPIKING):
            for field in set(vars(node)) - {"input_type", "output_type", "metadata"}:
                demand(same(getattr(node, field)), name, TOOL, f"needs one {field} for all neurons")
            _check(name, node, convention.dt)


def _check(name: str, node: nir.NIRNode, dt: float) -> None:
    """It refuses what it would compute differently, and so changes nothing."""
    if isinstance(node, nir.IF):
        demand(near(node.r, 1 / dt, 1e-6), name, TOOL, f"needs r = 1/dt = {1 / dt:g}")
    if isinstance(node, nir.LIF):
        unit = near(node.r, numbers(node.tau) / dt, 1e-6) | near(node.r, 1.0, 1e-6)
        demand(unit, name, TOOL, "needs r = 1 or tau/dt")
        demand(near(node.v_leak, numbers(node.v_reset), 1e-6), name, TOOL, "needs v_leak = v_reset")
    if isinstance(node, nir.CubaLIF):
        demand(near(node.r, numbers(node.tau_mem) / dt, 1e-6), name, TOOL, "needs r = tau_mem/dt")
        unit = near(node.w_in, numbers(node.tau_syn) / dt, 1e-6)
        demand(unit, name, TOOL, "needs w_in = tau_syn/dt")
        demand(near(node.v_leak, 0.0, 1e-6), name, TOOL, "needs v_leak = 0")


SPIKINGJELLY = Preset(
    tool=TOOL,
    kinds=(
        nir.Affine,
        nir.Linear,
        nir.Conv1d,
        nir.Conv2d,
        nir.AvgPool2d,
        nir.Flatten,
        nir.IF,
        nir.LIF,
        nir.CubaLIF,
    ),
    convention=stated(TOOL, 1e-4, spikes="reached"),
    options=("dt",),
    reading=_read,
    source="spikingjelly 2.0.0, activation_based/nir_exchange/from_nir.py and surrogate.heaviside",
)
