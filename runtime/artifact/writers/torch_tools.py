"""Norse, snnTorch and SpikingJelly: what their exports mean."""

from dataclasses import replace
from typing import Any

import nir
import numpy as np

from spikedeploy.runtime.artifact.presets import torch_tools as importers
from spikedeploy.runtime.artifact.presets.preset import (
    Nodes,
    Values,
    float64,
    is_close,
    with_gain,
    with_parameters,
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

_SNNTORCH_TOOL = importers.SNNTORCH.tool


def _timestep_snntorch(nodes: Nodes, given: float | None) -> tuple[float, str]:
    """Its neurons have decay factors and no dt; its export writes r = tau/dt with 1e-4."""
    found = from_gains(nodes, _SNNTORCH_TOOL, tau_over_r)
    if found is None:
        return given or 1e-4, ""
    why = (
        f", which {_SNNTORCH_TOOL} writes whatever its network was trained with; its decays count "
        "timesteps"
    )
    return not_contradicted(given, found, why), ""


def _translate_snntorch(nodes: Nodes, convention: Convention) -> Convention:
    for name, node in nodes.items():
        if isinstance(node, (nir.LIF, nir.CubaLIF)):
            must(node.v_leak == 0, name, _SNNTORCH_TOOL, "writes v_leak = 0")
            must(node.v_reset == 0, name, _SNNTORCH_TOOL, "writes v_reset = 0")
            nodes[name] = with_gain(_exact(node, convention.dt), convention)
    # where the threshold is not below 0; reset_delay=False, see runtime.float_model
    if convention.reset == "subtract":
        return replace(convention, reset="subtract-ahead")
    # b V is 0 after either: a Leaky fires alike
    current_based = any(isinstance(node, nir.CubaLIF) for node in nodes.values())
    late = convention.reset == "zero-delayed"
    return replace(convention, reset="zero") if late and not current_based else convention


def _exact(node: nir.NIRNode, dt: float) -> nir.NIRNode:
    """The neuron with time constants [s] of exactly its decay factors in float32."""
    taus = ("tau",) if isinstance(node, nir.LIF) else ("tau_syn", "tau_mem")
    return with_parameters(node, **{tau: _tau(getattr(node, tau), dt) for tau in taus})


def _tau(written: Any, dt: float) -> Values:  # noqa: ANN401
    """dt/(1 - beta), beta as the network had it."""
    beta = 1 - dt / float64(written)
    return np.asarray(dt / (1 - (beta.astype(written.dtype).astype(np.float64))))


SNNTORCH = Writer(
    tool=_SNNTORCH_TOOL,
    kinds=(
        nir.Affine,
        nir.Linear,
        nir.Conv2d,
        nir.Flatten,
        nir.AvgPool2d,
        nir.LIF,
        nir.CubaLIF,
    ),
    timestep=_timestep_snntorch,
    translate=_translate_snntorch,
    source="snntorch 1.0.0, export_nir.py, _neurons/leaky.py and _neurons/synaptic.py",
    open={
        "reset": Assumption(
            ("subtract-delayed", "zero", "subtract", "zero-delayed", "none"),
            "reset by subtraction, delayed, snnTorch's default (--reset zero or subtract if yours "
            "had reset_delay=False, zero-delayed or none if it had that reset_mechanism)",
        )
    },
)


_NORSE_TOOL = importers.NORSE.tool


def _timestep_norse(nodes: Nodes, given: float | None) -> tuple[float, str]:
    """Its files hold dt/tau_inv, that is tau times the dt of to_nir."""
    words = "dt = 0.001 s of neurons and of to_nir, Norse's default (--dt if yours was another)"
    return (1e-3, words) if given is None else (given, "")


def _translate_norse(nodes: Nodes, convention: Convention) -> Convention:
    dt = convention.dt
    for name, node in nodes.items():
        if isinstance(node, (nir.LIF, nir.CubaLIF, nir.LI, nir.IF)):
            must(node.r == 1, name, _NORSE_TOOL, "writes r = 1")
        if isinstance(node, (nir.LIF, nir.LI)):
            nodes[name] = with_parameters(node, tau=float64(node.tau) / dt)
        if isinstance(node, nir.CubaLIF):
            if convention.reset == "subtract":
                raise ConventionError(
                    f"node {name!r}: reset 'subtract': an LIFCell of {_NORSE_TOOL} resets to "
                    "v_reset, only an LIFBoxCell can subtract. Leave --reset away."
                )
            tau_syn, tau_mem = float64(node.tau_syn) / dt, float64(node.tau_mem) / dt
            # the input is added to the current whole
            nodes[name] = with_parameters(node, tau_syn=tau_syn, tau_mem=tau_mem, w_in=tau_syn / dt)
        if isinstance(node, nir.IF):
            # the input is added whatever dt is
            nodes[name] = with_parameters(node, r=np.full(node.r.shape, 1 / dt))
    return convention


NORSE = Writer(
    tool=_NORSE_TOOL,
    kinds=(nir.Affine, nir.Conv2d, nir.LIF, nir.CubaLIF, nir.LI, nir.IF),
    timestep=_timestep_norse,
    translate=_translate_norse,
    source="norse 1.1.0, torch/utils/export_nir.py, torch/functional/lif.py and lif_box.py",
    open={
        "reset": Assumption(
            ("zero", "subtract"),
            "reset to v_reset, Norse's default (--reset subtract if reset_method was "
            "reset_subtract)",
        )
    },
    always=("v_reset = 0, its default",),
)


_SPIKINGJELLY_TOOL = importers.SPIKINGJELLY.tool


def _says_dt(node: nir.NIRNode) -> Any:  # noqa: ANN401
    """The dt in r = 1/dt or tau/dt; None of a LIFNode with decay_input, whose r is 1."""
    if isinstance(node, nir.IF):
        return 1 / float64(node.r)
    decays_input = isinstance(node, nir.LIF) and is_close(node.r, 1.0).all()
    return None if decays_input else tau_over_r(node)


def _timestep_spikingjelly(nodes: Nodes, given: float | None) -> tuple[float, str]:
    found = from_gains(nodes, _SPIKINGJELLY_TOOL, _says_dt)
    if found is None:
        words = "dt = 0.0001 s of export_to_nir, its default (--dt if yours was another)"
        return (1e-4, words) if given is None else (given, "")
    return not_contradicted(given, found), ""


def _translate_spikingjelly(nodes: Nodes, convention: Convention) -> Convention:
    for name, node in nodes.items():
        if isinstance(node, (nir.LIF, nir.CubaLIF)):
            same = is_close(node.v_leak, float64(node.v_reset))
            must(same, name, _SPIKINGJELLY_TOOL, "writes v_leak = v_reset")
        if isinstance(node, nir.LIF):
            own = _from_rest(with_parameters(node, v_leak=np.zeros(node.v_leak.shape)))
            nodes[name] = own if _says_dt(node) is None else with_gain(own, convention)
        if isinstance(node, nir.IF):
            nodes[name] = with_gain(_from_rest(node), convention)
        if isinstance(node, nir.CubaLIF):
            nodes[name] = with_gain(node, convention)
    return convention


def _from_rest(node: nir.NIRNode) -> nir.NIRNode:
    """The neuron with its membrane counted from v_reset, where it begins and rests."""
    return with_parameters(
        node,
        v_threshold=float64(node.v_threshold) - float64(node.v_reset),
        v_reset=np.zeros(node.v_reset.shape),
    )


SPIKINGJELLY = Writer(
    tool=_SPIKINGJELLY_TOOL,
    kinds=importers.SPIKINGJELLY.kinds,
    timestep=_timestep_spikingjelly,
    translate=_translate_spikingjelly,
    source="spikingjelly 2.0.0, activation_based/nir_exchange/to_nir.py and neuron/lif.py",
    # a soft reset is not exported
    fixed={"spikes": "reached"},
)
