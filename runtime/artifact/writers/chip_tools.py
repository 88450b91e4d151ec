"""Lava, Rockpool and sinabs: what their exports mean.

Read in the source and worked out by hand; none of them can be asked in our tests.
"""

from typing import Any

import nir
import numpy as np

from spikedeploy.runtime.artifact.presets import synsense
from spikedeploy.runtime.artifact.presets.preset import (
    Nodes,
    Values,
    float64,
    with_gain,
    with_zero_reset,
)
from spikedeploy.runtime.artifact.writers.writer import (
    Assumption,
    Writer,
    from_gains,
    must,
    not_contradicted,
    tau_over_r,
)
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.errors import ConventionError

_LAVA_TOOL = "Lava (lava_to_nir.py)"


def _timestep_lava(nodes: Nodes, given: float | None) -> tuple[float, str]:
    """Decays of a Loihi neuron have no dt; the script writes tau = dt/decay with 1e-4."""
    return _stated(nodes, given, _LAVA_TOOL, from_gains(nodes, _LAVA_TOOL, tau_over_r))


def _stated(nodes: Nodes, given: float | None, tool: str, found: float | None) -> tuple[float, str]:
    """The dt of the gains, which no other may contradict."""
    if found is None:
        raise ConventionError(
            f"{tool} writes its dt into the gains of CubaLIF nodes, and there are none. Name the "
            "tool that wrote the file, or read it without --from."
        )
    return not_contradicted(given, found), ""


def _translate_lava(nodes: Nodes, convention: Convention) -> Convention:
    for name, node in nodes.items():
        if isinstance(node, nir.Affine):
            zero = np.asarray(node.bias) == 0
            must(
                zero,
                name,
                _LAVA_TOOL,
                "divides weights by 64 and not biases, which is no network"
                " that ran: biases must be 0",
            )
        if isinstance(node, nir.CubaLIF):
            must(node.v_leak == 0, name, _LAVA_TOOL, "writes v_leak = 0")
            nodes[name] = with_gain(with_zero_reset(node), convention)
    return convention


LAVA = Writer(
    tool=_LAVA_TOOL,
    kinds=(nir.Affine, nir.Linear, nir.CubaLIF),
    timestep=_timestep_lava,
    translate=_translate_lava,
    source="github.com/neuromorphs/NIR docs/source/examples/lava/lava_to_nir.py, for the .net "
    "files of lava-dl",
    open={
        "delay": Assumption(
            (1, 0),
            "a delay of one timestep into each layer, as Lava runs the network (--delay 0 for "
            "lava-dl without delay_shift)",
        ),
        "spikes": Assumption(
            ("above", "reached"),
            "spikes above the threshold, as in Lava (--spikes reached for lava-dl)",
        ),
    },
)


_ROCKPOOL_TOOL = synsense.ROCKPOOL.tool


def _says_dt(node: nir.NIRNode) -> Any:  # noqa: ANN401
    """The dt [s] for which r = tau exp(-dt/tau)/dt."""
    if not isinstance(node, nir.CubaLIF):
        return None
    tau, r = float64(node.tau_mem), float64(node.r)
    return tau * _product_log(1 / r)


def _product_log(x: Values) -> Values:
    """Lambert's W: u with u exp(u) = x, of x above 0, by Newton's method."""
    u = np.log1p(x)
    for _ in range(50):
        u = u - (u * np.exp(u) - x) / (np.exp(u) * (1 + u))
    return np.asarray(u)


def _timestep_rockpool(nodes: Nodes, given: float | None) -> tuple[float, str]:
    for name, node in sorted(nodes.items()):
        if isinstance(node, nir.CubaLIF):
            must(node.r > 0, name, _ROCKPOOL_TOOL, "writes r = tau exp(-dt/tau)/dt, above 0")
    found = from_gains(nodes, _ROCKPOOL_TOOL, _says_dt, tolerance=1e-4)
    return _stated(nodes, given, _ROCKPOOL_TOOL, found)


def _translate_rockpool(nodes: Nodes, convention: Convention) -> Convention:
    for name, node in nodes.items():
        if isinstance(node, nir.CubaLIF):
            must(node.v_leak == 0, name, _ROCKPOOL_TOOL, "writes v_leak = 0")
            # I = a (I + x); V = b V + I
            decayed = np.exp(-convention.dt / float64(node.tau_syn))
            nodes[name] = with_gain(with_zero_reset(node), convention, decayed)
    return convention


ROCKPOOL = Writer(
    tool=_ROCKPOOL_TOOL,
    kinds=synsense.ROCKPOOL.kinds,
    timestep=_timestep_rockpool,
    translate=_translate_rockpool,
    source="rockpool 3.1.0, nn/modules/torch/nir.py and lif_torch.py",
    fixed={"integrator": "exponential", "reset": "subtract", "spikes": "many"},
    always=("no bias of LIFTorch and no recurrent weights, which to_nir leaves out",),
)


_SINABS_TOOL = synsense.SINABS.tool


def _timestep_sinabs(nodes: Nodes, given: float | None) -> tuple[float, str]:
    """Time constants are in timesteps."""
    if given is not None and given != 1:
        raise ConventionError(
            f"dt = {given:g} s: {_SINABS_TOOL} counts its time constants in timesteps, and writes "
            "them so. Leave dt away."
        )
    return 1.0, ""


def _translate_sinabs(nodes: Nodes, convention: Convention) -> Convention:
    for name, node in nodes.items():
        if isinstance(node, (nir.LIF, nir.LI, nir.IF)):
            must(node.r == 1, name, _SINABS_TOOL, "writes r = 1")
        if isinstance(node, (nir.LIF, nir.LI)):
            must(node.v_leak == 0, name, _SINABS_TOOL, "writes v_leak = 0")
        if isinstance(node, nir.LI):
            # norm_input is False by default in ExpLeak, and True in LIF, where r = 1 is right
            nodes[name] = with_gain(node, convention)
    return convention


SINABS = Writer(
    tool=_SINABS_TOOL,
    kinds=synsense.SINABS.kinds,
    timestep=_timestep_sinabs,
    translate=_translate_sinabs,
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
