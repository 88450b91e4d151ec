"""Rockpool and sinabs, SynSense's tools: their imports of NIR."""

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
from spikedeploy.runtime.convention import Convention, Floor
from spikedeploy.runtime.errors import ConventionError

_ROCKPOOL_TOOL = "Rockpool 3.1.0"


def _timestep(node: nir.CubaLIF) -> float:
    """The dt [s] that its import gives a layer; its export writes r = tau exp(-dt/tau)/dt."""
    with np.errstate(divide="ignore", invalid="ignore"):  # r of -1 is refused by name
        return float((float64(node.tau_mem) / (1 + float64(node.r))).min())


def _convention_rockpool(nodes: Nodes, _: float | None) -> Convention:
    layers = {n: node for n, node in sorted(nodes.items()) if isinstance(node, nir.CubaLIF)}
    if not layers:
        raise ConventionError(
            f"{_ROCKPOOL_TOOL} takes its timestep from r of CubaLIF nodes, and there are none. "
            "Read the file without the preset."
        )
    for name, node in layers.items():
        require(
            0 < _timestep(node) < np.inf,
            name,
            _ROCKPOOL_TOOL,
            "takes dt = tau_mem/(1 + r), which is not above 0 and finite",
        )
    dt = min(_timestep(node) for node in layers.values())
    source = f"as {_ROCKPOOL_TOOL} reads it: dt = tau_mem/(1 + r) of each layer"
    return Convention(dt, "subtract", "exponential", source=source, spikes="many")


def _translate_rockpool(nodes: Nodes, edges: Edges, convention: Convention) -> None:
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
    tool=_ROCKPOOL_TOOL,
    kinds=(nir.Affine, nir.Linear, nir.CubaLIF),
    convention=_convention_rockpool,
    options=(),
    translate=_translate_rockpool,
    source="rockpool 3.1.0, nn/modules/torch/nir.py and lif_torch.py",
)


_SINABS_TOOL = "sinabs 3.1.3"


def _convention_sinabs(nodes: Nodes, _: float | None) -> Convention:
    """Time constants are in timesteps; only integrators have a floor."""
    kinds = {type(node) for node in nodes.values()} & {nir.IF, nir.LIF}
    first = next((name for name, node in sorted(nodes.items()) if isinstance(node, nir.IF)), "")
    require(
        len(kinds) < 2,
        first,
        _SINABS_TOOL,
        "floors the membranes of IF and not those of LIF, and the graph has both",
    )
    source = f"as {_SINABS_TOOL} reads it: tau in timesteps"
    floor: Floor = "threshold" if nir.IF in kinds else "none"
    return Convention(1.0, "subtract", "exponential", source=source, spikes="many", floor=floor)


def _translate_sinabs(nodes: Nodes, edges: Edges, convention: Convention) -> None:
    for name, node in nodes.items():
        if isinstance(node, nir.SumPool2d):
            nodes[name] = with_parameters(node, padding=np.zeros(2, int))
        if isinstance(node, (nir.LIF, nir.LI)):
            require(node.v_leak == 0, name, _SINABS_TOOL, "needs v_leak = 0")
        if isinstance(node, nir.LI):
            require(node.r == 1, name, _SINABS_TOOL, "needs r = 1")
        if isinstance(node, (nir.IF, nir.LIF, nir.LI)):
            # norm_input is False: the input has gain 1, and r is ignored
            unit = with_gain(node, convention)
            nodes[name] = unit if isinstance(node, nir.LI) else with_zero_reset(unit)


SINABS = Preset(
    tool=_SINABS_TOOL,
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
    convention=_convention_sinabs,
    options=(),
    translate=_translate_sinabs,
    source="sinabs 3.1.3, nir.py, layers/functional/lif.py and activation/spike_generation.py",
)
