"""SpikingJelly: its import of NIR, what its export means, and networks written for its import."""

from typing import Any

import nir
import numpy as np

from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.dialects.dialect import (
    Preset,
    Writer,
    float64,
    is_close,
    is_uniform,
    require,
    tau_over_r,
    with_gain,
    with_parameters,
)
from spikedeploy.runtime.dialects.rewriting import Importer
from spikedeploy.runtime.graph.neurons import SPIKING

_TOOL = "SpikingJelly 2.0.0"
_KINDS = (
    nir.Affine, nir.Linear, nir.Conv1d, nir.Conv2d, nir.AvgPool2d, nir.Flatten, nir.IF, nir.LIF,
    nir.CubaLIF,
)  # fmt: skip
_CLOSE = 1e-6  # relative, by which its import compares


def _read(name: str, node: nir.NIRNode, convention: Convention) -> nir.NIRNode:
    """The node itself: it refuses every one that it would compute differently."""
    dt = convention.dt
    if isinstance(node, (nir.Conv1d, nir.Conv2d)):
        require(node.groups == 1, name, "reads no grouped convolution")
    if isinstance(node, SPIKING):
        for field in set(vars(node)) - {"input_type", "output_type", "metadata"}:
            require(is_uniform(getattr(node, field)), name, f"needs one {field} for all neurons")
    if isinstance(node, nir.IF):
        require(is_close(node.r, 1 / dt, _CLOSE), name, f"needs r = 1/dt = {1 / dt:g}")
    if isinstance(node, nir.LIF):
        unit = is_close(node.r, float64(node.tau) / dt, _CLOSE) | is_close(node.r, 1.0, _CLOSE)
        require(unit, name, "needs r = 1 or tau/dt")
        at_rest = is_close(node.v_leak, float64(node.v_reset), _CLOSE)
        require(at_rest, name, "needs v_leak = v_reset")
    if isinstance(node, nir.CubaLIF):
        unit = is_close(node.r, float64(node.tau_mem) / dt, _CLOSE)
        require(unit, name, "needs r = tau_mem/dt")
        unit = is_close(node.w_in, float64(node.tau_syn) / dt, _CLOSE)
        require(unit, name, "needs w_in = tau_syn/dt")
        require(is_close(node.v_leak, 0.0, _CLOSE), name, "needs v_leak = 0")
    return node


PRESET = Preset(
    tool=_TOOL,
    kinds=_KINDS,
    convention=lambda nodes: Convention(1e-4, spikes="reached"),
    options=("dt",),
    translate=_read,
    source="spikingjelly 2.0.0, activation_based/nir_exchange/from_nir.py and surrogate.heaviside",
)


def _stated_timestep(name: str, node: nir.NIRNode) -> Any:  # noqa: ANN401
    """The dt in r = 1/dt or tau/dt; None of a LIFNode with decay_input, whose r is 1."""
    if isinstance(node, nir.IF):
        return 1 / float64(node.r)
    decays_input = isinstance(node, nir.LIF) and is_close(node.r, 1.0).all()
    return None if decays_input else tau_over_r(name, node)


def _as_meant(name: str, node: nir.NIRNode, convention: Convention) -> nir.NIRNode:
    if isinstance(node, (nir.LIF, nir.CubaLIF)):
        same = is_close(node.v_leak, float64(node.v_reset))
        require(same, name, "writes v_leak = v_reset")
    if not isinstance(node, SPIKING):
        return node
    own = node if isinstance(node, nir.CubaLIF) else _from_rest(node)
    return own if _stated_timestep(name, node) is None else with_gain(own, convention)


def _from_rest(node: nir.NIRNode) -> nir.NIRNode:
    """The neuron with its membrane counted from v_reset, where it begins and rests."""
    zero = np.zeros(node.v_reset.shape)
    threshold = float64(node.v_threshold) - float64(node.v_reset)
    leak = {"v_leak": zero} if isinstance(node, nir.LIF) else {}
    return with_parameters(node, v_threshold=threshold, v_reset=zero, **leak)


WRITER = Writer(
    tool=_TOOL,
    kinds=_KINDS,
    timestep=_stated_timestep,
    default_timestep=(
        1e-4,
        "dt = 0.0001 s of export_to_nir, its default (--dt if yours was another)",
    ),
    translate=_as_meant,
    source="spikingjelly 2.0.0, activation_based/nir_exchange/to_nir.py and neuron/lif.py",
    # a soft reset is not exported
    fixed={"spikes": "reached"},
)

IMPORTER = Importer(v_reset=True)
