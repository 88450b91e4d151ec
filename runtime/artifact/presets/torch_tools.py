"""Norse, snnTorch and SpikingJelly: their imports of NIR."""

import nir
import numpy as np

from spikedeploy.runtime.artifact.presets.preset import (
    Edges,
    Nodes,
    Preset,
    default_convention,
    float64,
    is_close,
    is_uniform,
    require,
    with_batch_axis,
    with_gain,
    with_parameters,
    with_zero_reset,
)
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.graph.neurons import SPIKING

_NORSE_TOOL = "Norse 1.1.0"


def _translate_norse(nodes: Nodes, edges: Edges, convention: Convention) -> None:
    for name, node in nodes.items():
        if isinstance(node, nir.Flatten):
            nodes[name] = with_batch_axis(node)
        if isinstance(node, nir.SumPool2d):
            nodes[name] = with_parameters(node, padding=np.zeros(2, int))
        if isinstance(node, (nir.IF, nir.LIF)):
            require(
                convention.reset == "zero",
                name,
                _NORSE_TOOL,
                "subtracts after spikes of CubaLIF only",
            )
            # it ignores r, with a warning; an IF adds its input whatever dt is
            r = np.full(node.r.shape, 1 / convention.dt if isinstance(node, nir.IF) else 1.0)
            nodes[name] = with_zero_reset(with_parameters(node, r=r))
        if isinstance(node, nir.CubaLIF):
            require(node.v_leak == 0, name, _NORSE_TOOL, "would add v_leak to the synapse as well")
            nodes[name] = with_zero_reset(node)


NORSE = Preset(
    tool=_NORSE_TOOL,
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
    convention=default_convention(_NORSE_TOOL, 1e-3),
    options=("dt", "reset"),
    translate=_translate_norse,
    source="norse 1.1.0, torch/utils/import_nir.py and torch/functional/lif_box.py",
)


_SNNTORCH_TOOL = "snnTorch 1.0.0"


def _translate_snntorch(nodes: Nodes, edges: Edges, convention: Convention) -> None:
    for name, node in nodes.items():
        if isinstance(node, nir.Flatten):
            nodes[name] = with_batch_axis(node)
        if isinstance(node, nir.IF):
            require(
                False,
                name,
                _SNNTORCH_TOOL,
                "reads IF as a leaky neuron of decay factor 0.9 (its issue 416)",
            )
        if isinstance(node, (nir.LIF, nir.CubaLIF)):
            nodes[name] = _neuron(name, node, convention)


def _neuron(name: str, node: nir.NIRNode, convention: Convention) -> nir.NIRNode:
    """The neuron with a gain of 1; another gain of the file divides the threshold instead."""
    require(node.v_leak == 0, name, _SNNTORCH_TOOL, "needs v_leak = 0")
    if isinstance(node, nir.CubaLIF):
        close = is_close(node.r, float64(node.tau_mem) / convention.dt)
        require(
            close,
            name,
            _SNNTORCH_TOOL,
            f"needs r = tau_mem/dt, dt being {convention.dt:g} s always",
        )
        scale = float64(node.w_in) * convention.dt / float64(node.tau_syn)
    else:
        scale = float64(node.r) * convention.dt / float64(node.tau)
    threshold = float64(node.v_threshold)
    if not is_close(scale, 1.0).all():
        require(scale > 0, name, _SNNTORCH_TOOL, "needs gains above 0")
        threshold = threshold / scale
    require(
        is_uniform(np.round(threshold, 12)),
        name,
        _SNNTORCH_TOOL,
        "needs one threshold for all neurons",
    )
    return with_zero_reset(with_parameters(with_gain(node, convention), v_threshold=threshold))


SNNTORCH = Preset(
    tool=_SNNTORCH_TOOL,
    kinds=(
        nir.Affine,
        nir.Linear,
        nir.Conv2d,
        nir.Flatten,
        nir.AvgPool2d,
        nir.IF,
        nir.LIF,
        nir.CubaLIF,
    ),
    convention=default_convention(_SNNTORCH_TOOL, 1e-4),
    options=(),
    translate=_translate_snntorch,
    source="snntorch 1.0.0, import_nir.py: dt, reset_mechanism and reset_delay are constants there",
)


_SPIKINGJELLY_TOOL = "SpikingJelly 2.0.0"


def _translate_spikingjelly(nodes: Nodes, edges: Edges, convention: Convention) -> None:
    for name, node in nodes.items():
        if isinstance(node, (nir.Conv1d, nir.Conv2d)):
            require(node.groups == 1, name, _SPIKINGJELLY_TOOL, "reads no grouped convolution")
        if isinstance(node, SPIKING):
            for field in set(vars(node)) - {"input_type", "output_type", "metadata"}:
                require(
                    is_uniform(getattr(node, field)),
                    name,
                    _SPIKINGJELLY_TOOL,
                    f"needs one {field} for all neurons",
                )
            _check(name, node, convention.dt)


def _check(name: str, node: nir.NIRNode, dt: float) -> None:
    """It refuses every node that it would compute differently, so nothing is translated."""
    if isinstance(node, nir.IF):
        require(
            is_close(node.r, 1 / dt, 1e-6), name, _SPIKINGJELLY_TOOL, f"needs r = 1/dt = {1 / dt:g}"
        )
    if isinstance(node, nir.LIF):
        unit = is_close(node.r, float64(node.tau) / dt, 1e-6) | is_close(node.r, 1.0, 1e-6)
        require(unit, name, _SPIKINGJELLY_TOOL, "needs r = 1 or tau/dt")
        require(
            is_close(node.v_leak, float64(node.v_reset), 1e-6),
            name,
            _SPIKINGJELLY_TOOL,
            "needs v_leak = v_reset",
        )
    if isinstance(node, nir.CubaLIF):
        require(
            is_close(node.r, float64(node.tau_mem) / dt, 1e-6),
            name,
            _SPIKINGJELLY_TOOL,
            "needs r = tau_mem/dt",
        )
        unit = is_close(node.w_in, float64(node.tau_syn) / dt, 1e-6)
        require(unit, name, _SPIKINGJELLY_TOOL, "needs w_in = tau_syn/dt")
        require(is_close(node.v_leak, 0.0, 1e-6), name, _SPIKINGJELLY_TOOL, "needs v_leak = 0")


SPIKINGJELLY = Preset(
    tool=_SPIKINGJELLY_TOOL,
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
    convention=default_convention(_SPIKINGJELLY_TOOL, 1e-4, spikes="reached"),
    options=("dt",),
    translate=_translate_spikingjelly,
    source="spikingjelly 2.0.0, activation_based/nir_exchange/from_nir.py and surrogate.heaviside",
)
