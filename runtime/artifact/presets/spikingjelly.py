"""SpikingJelly: its import of NIR."""

import nir

from spikedeploy.runtime.artifact.presets.preset import (
    Edges,
    Nodes,
    Preset,
    default_convention,
    float64,
    is_close,
    is_uniform,
    require,
)
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.graph.neurons import SPIKING

TOOL = "SpikingJelly 2.0.0"


def _translate(nodes: Nodes, edges: Edges, convention: Convention) -> None:
    for name, node in nodes.items():
        if isinstance(node, (nir.Conv1d, nir.Conv2d)):
            require(node.groups == 1, name, TOOL, "reads no grouped convolution")
        if isinstance(node, SPIKING):
            for field in set(vars(node)) - {"input_type", "output_type", "metadata"}:
                require(
                    is_uniform(getattr(node, field)),
                    name,
                    TOOL,
                    f"needs one {field} for all neurons",
                )
            _check(name, node, convention.dt)


def _check(name: str, node: nir.NIRNode, dt: float) -> None:
    """It refuses every node that it would compute differently, so nothing is translated."""
    if isinstance(node, nir.IF):
        require(is_close(node.r, 1 / dt, 1e-6), name, TOOL, f"needs r = 1/dt = {1 / dt:g}")
    if isinstance(node, nir.LIF):
        unit = is_close(node.r, float64(node.tau) / dt, 1e-6) | is_close(node.r, 1.0, 1e-6)
        require(unit, name, TOOL, "needs r = 1 or tau/dt")
        require(
            is_close(node.v_leak, float64(node.v_reset), 1e-6), name, TOOL, "needs v_leak = v_reset"
        )
    if isinstance(node, nir.CubaLIF):
        require(
            is_close(node.r, float64(node.tau_mem) / dt, 1e-6), name, TOOL, "needs r = tau_mem/dt"
        )
        unit = is_close(node.w_in, float64(node.tau_syn) / dt, 1e-6)
        require(unit, name, TOOL, "needs w_in = tau_syn/dt")
        require(is_close(node.v_leak, 0.0, 1e-6), name, TOOL, "needs v_leak = 0")


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
    convention=default_convention(TOOL, 1e-4, spikes="reached"),
    options=("dt",),
    translate=_translate,
    source="spikingjelly 2.0.0, activation_based/nir_exchange/from_nir.py and surrogate.heaviside",
)
