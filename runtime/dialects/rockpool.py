"""Rockpool: its import of NIR, what its export means, and networks written for its import.

The export is read in its source and worked out by hand.
"""

from typing import Any

import nir
import numpy as np

from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.dialects.dialect import (
    Nodes,
    Preset,
    Values,
    Writer,
    float64,
    one_minus_decay,
    require,
    with_gain,
    with_parameters,
    with_zero_reset,
)
from spikedeploy.runtime.dialects.rewriting import Importer
from spikedeploy.runtime.errors import ConventionError
from spikedeploy.runtime.graph.neurons import DiscreteNeuron

_TOOL = "Rockpool 3.1.0"
_KINDS = (nir.Affine, nir.Linear, nir.CubaLIF)


def _timestep(node: nir.CubaLIF) -> float:
    """The dt [s] that its import gives a layer; its export writes r = tau exp(-dt/tau)/dt."""
    with np.errstate(divide="ignore", invalid="ignore"):  # r of -1 is refused by name
        return float((float64(node.tau_mem) / (1 + float64(node.r))).min())


def _convention(nodes: Nodes) -> Convention:
    steps = {n: _timestep(node) for n, node in nodes.items() if isinstance(node, nir.CubaLIF)}
    if not steps:
        raise ConventionError(
            f"{_TOOL} takes its timestep from r of CubaLIF nodes, and there are none. "
            "Read the file without the preset."
        )
    for name, dt in sorted(steps.items()):
        finite = "takes dt = tau_mem/(1 + r), which is not above 0 and finite"
        require(0 < dt < np.inf, name, finite)
    return Convention(min(steps.values()), "subtract", "exponential", spikes="many")


def _read(name: str, node: nir.NIRNode, convention: Convention) -> nir.NIRNode:
    """I = a (I + x); V = b V + I + v_leak: r and w_in are ignored, v_leak is a bias."""
    if not isinstance(node, nir.CubaLIF):
        return node
    # layers of different dt are stepped together, so their time constants are scaled
    stretch = convention.dt / _timestep(node)
    tau_syn, tau_mem = stretch * float64(node.tau_syn), stretch * float64(node.tau_mem)
    leak = float64(node.v_leak) / one_minus_decay(tau_mem, convention)
    own = with_zero_reset(node, tau_syn=tau_syn, tau_mem=tau_mem, v_leak=leak)
    return with_gain(own, convention, np.exp(-convention.dt / tau_syn))


PRESET = Preset(
    tool=_TOOL,
    kinds=_KINDS,
    convention=_convention,
    remark="dt = tau_mem/(1 + r) of each layer",
    translate=_read,
    source="rockpool 3.1.0, nn/modules/torch/nir.py and lif_torch.py",
)


def _stated_timestep(name: str, node: nir.NIRNode) -> Any:  # noqa: ANN401
    """The dt [s] for which r = tau exp(-dt/tau)/dt."""
    if not isinstance(node, nir.CubaLIF):
        return None
    require(node.r > 0, name, "writes r = tau exp(-dt/tau)/dt, above 0")
    return float64(node.tau_mem) * _product_log(1 / float64(node.r))


def _product_log(x: Values) -> Values:
    """Lambert's W: u with u exp(u) = x, of x above 0, by Newton's method."""
    u = np.log1p(x)
    for _ in range(50):
        u = u - (u * np.exp(u) - x) / (np.exp(u) * (1 + u))
    return np.asarray(u)


def _as_meant(name: str, node: nir.NIRNode, convention: Convention) -> nir.NIRNode:
    """I = a (I + x); V = b V + I."""
    if not isinstance(node, nir.CubaLIF):
        return node
    require(node.v_leak == 0, name, "writes v_leak = 0")
    decayed = np.exp(-convention.dt / float64(node.tau_syn))
    return with_gain(with_zero_reset(node), convention, decayed)


WRITER = Writer(
    tool=_TOOL,
    kinds=_KINDS,
    timestep=_stated_timestep,
    tolerance=1e-4,
    translate=_as_meant,
    source="rockpool 3.1.0, nn/modules/torch/nir.py and lif_torch.py",
    fixed={"integrator": "exponential", "reset": "subtract", "spikes": "many"},
    always=("no bias of LIFTorch and no recurrent weights, which to_nir leaves out",),
)


def _import_gain(kind: type[nir.NIRNode], neuron: DiscreteNeuron) -> Values:
    """The factor a of I = a (I + x)."""
    return np.ones_like(neuron.gain) if neuron.current_decay is None else neuron.current_decay


def _finish(node: nir.NIRNode, neuron: DiscreteNeuron) -> nir.NIRNode:
    """The neurons with the r from which it takes dt, and a w_in that it ignores and we do not."""
    if neuron.current_decay is None:
        return node
    a, b, r = neuron.current_decay, neuron.membrane_decay, node.r - 1
    return with_parameters(node, r=r, w_in=a / ((1 - a) * (1 - b) * r))


IMPORTER = Importer(
    uniform=False,
    resets=("subtract",),
    convention=lambda own: Convention(own.dt, "subtract", "exponential", spikes="many"),
    gain=_import_gain,
    finish=_finish,
)
