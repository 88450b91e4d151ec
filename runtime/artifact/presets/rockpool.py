"""Rockpool: its import of NIR."""

import nir
import numpy as np

from spikedeploy.runtime.artifact.presets.preset import (
    Edges,
    Nodes,
    Preset,
    float64,
    one_minus_decay,
    require,
    with_gain,
    with_parameters,
    with_zero_reset,
)
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.errors import ConventionError

TOOL = "Rockpool 3.1.0"


def _timestep(node: nir.CubaLIF) -> float:
    """The dt [s] that its import gives a layer; its export writes r = tau exp(-dt/tau)/dt."""
    return float((float64(node.tau_mem) / (1 + float64(node.r))).min())


def _convention(nodes: Nodes, _: float | None) -> Convention:
    layers = {n: node for n, node in sorted(nodes.items()) if isinstance(node, nir.CubaLIF)}
    if not layers:
        raise ConventionError(
            f"{TOOL} takes its timestep from r of CubaLIF nodes, and there are none. Read the file "
            "without the preset."
        )
    for name, node in layers.items():
        require(_timestep(node) > 0, name, TOOL, "takes dt = tau_mem/(1 + r), which is not above 0")
    dt = min(_timestep(node) for node in layers.values())
    source = f"as {TOOL} reads it: dt = tau_mem/(1 + r) of each layer"
    return Convention(dt, "subtract", "exponential", source=source, spikes="many")


def _translate(nodes: Nodes, edges: Edges, convention: Convention) -> None:
    for name, node in nodes.items():
        if isinstance(node, nir.CubaLIF):
            nodes[name] = _neuron(node, convention)


def _neuron(node: nir.CubaLIF, convention: Convention) -> nir.NIRNode:
    """I = a (I + x); V = b V + I + v_leak: r and w_in are ignored, v_leak is a bias."""
    # layers of different dt are stepped together, so their time constants are scaled
    stretch = convention.dt / _timestep(node)
    tau_syn, tau_mem = stretch * float64(node.tau_syn), stretch * float64(node.tau_mem)
    own = with_zero_reset(with_parameters(node, tau_syn=tau_syn, tau_mem=tau_mem))
    leak = float64(node.v_leak) / one_minus_decay(tau_mem, convention)
    return with_gain(
        with_parameters(own, v_leak=leak), convention, np.exp(-convention.dt / tau_syn)
    )


ROCKPOOL = Preset(
    tool=TOOL,
    kinds=(nir.Affine, nir.Linear, nir.CubaLIF),
    convention=_convention,
    options=(),
    translate=_translate,
    source="rockpool 3.1.0, nn/modules/torch/nir.py and lif_torch.py",
)
