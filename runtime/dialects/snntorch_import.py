"""snnTorch: how it reads a NIR file, what it means by one that it wrote, and what it accepts.

Its export was compared with the tool itself.
"""

from dataclasses import replace

import nir
import numpy as np

from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.dialects.dialect import (
    Assumption,
    EdgeList,
    Edges,
    Importer,
    Nodes,
    Preset,
    Writer,
    is_close,
    is_uniform,
    require,
    require_values,
    tau_over_r,
    with_batch_axis,
    with_gain,
    with_parameters,
    with_zero_reset,
)
from spikedeploy.runtime.graph.discretisation import SPIKING, float64

_TOOL = "snnTorch 1.0.0"
_RATE = 1e4  # 1/dt of its export [1/s]
_ENDLESS = 2.0**60 / _RATE  # [s], whose decay factor rounds to 1 in float64
_MAPS = (nir.Affine, nir.Linear, nir.Conv2d, nir.Flatten, nir.AvgPool2d)


def _reads(name: str, node: nir.NIRNode, convention: Convention) -> nir.NIRNode:
    """The neuron with a gain of 1; another gain of the file divides the threshold instead."""
    if isinstance(node, nir.Flatten):
        return with_batch_axis(node)
    leaky = "reads IF as a leaky neuron of decay factor 0.9 (its issue 416)"
    require(not isinstance(node, nir.IF), name, leaky)
    if not isinstance(node, (nir.LIF, nir.CubaLIF)):
        return node
    require_values(name, node, "needs", v_leak=0)
    dt = convention.dt
    if isinstance(node, nir.CubaLIF):
        unit = is_close(node.r, float64(node.tau_mem) / dt)
        require(unit, name, f"needs r = tau_mem/dt, dt being {dt:g} s always")
        scale = float64(node.w_in) * dt / float64(node.tau_syn)
    else:
        scale = float64(node.r) * dt / float64(node.tau)
    threshold = float64(node.v_threshold)
    if not is_close(scale, 1.0).all():
        require(scale > 0, name, "needs gains above 0")
        threshold = threshold / scale
    one = is_uniform(np.round(threshold, 12))
    require(one, name, "needs one threshold for all neurons")
    return with_zero_reset(with_gain(node, convention), v_threshold=threshold)


def _means(name: str, node: nir.NIRNode, convention: Convention) -> nir.NIRNode:
    """The neuron with time constants [s] of exactly its decay factors in float32."""
    if not isinstance(node, (nir.IF, nir.LIF, nir.CubaLIF)):
        return node
    require_values(name, node, "writes", v_leak=0, v_reset=0)
    if isinstance(node, nir.IF):
        require(node.r == _RATE, name, "writes no IF, but a Leaky of beta = 1")
        return with_gain(node, convention)
    dt, exact = convention.dt, {}
    for field in ("tau",) if isinstance(node, nir.LIF) else ("tau_syn", "tau_mem"):
        # dt/(1 - beta), beta as the network had it; it clamps beta between 0 and 1
        beta = np.clip(1 - dt / float64(getattr(node, field)), 0, 1)
        single = beta.astype(np.float32).astype(np.float64)
        rounding = np.finfo(getattr(node, field).dtype).eps
        beta = np.where(np.abs(single - beta) <= rounding, single, beta)
        with np.errstate(divide="ignore"):
            exact[field] = np.minimum(dt / (1 - np.where(beta <= rounding, 0, beta)), _ENDLESS)
    return with_gain(with_parameters(node, **exact), convention)


def _finite(node: nir.NIRNode) -> nir.NIRNode:
    """The neuron without the infinite tau and r of a decay factor of 1, or negative ones beyond 1.

    An IF where all neurons of a Leaky have it, else time constants that do not decay in float64.
    """
    if not isinstance(node, (nir.LIF, nir.CubaLIF)):
        return node
    values = {n: each for n, each in vars(node).items() if isinstance(each, np.ndarray)}
    if any(each.dtype.kind != "f" for each in values.values()):
        return node
    finite = {}
    for tau, gain in (("tau", "r"), ("tau_mem", "r"), ("tau_syn", "w_in")):
        if tau not in values or values[tau].shape != values[gain].shape:
            continue
        times, gains = float64(values[tau]), float64(values[gain])
        # dt/(1 - beta) of beta = 1 or above, which it clamps to 1
        endless = (np.isposinf(times) & np.isposinf(gains)) | ((times < 0) & (gains < 0))
        if not endless.any():
            continue
        if tau == "tau" and endless.all() and not node.v_leak.any():
            return nir.IF(np.full(gains.shape, _RATE), node.v_threshold, node.v_reset)
        finite[tau] = np.where(endless, _ENDLESS, times)
        finite[gain] = np.where(endless, _ENDLESS * _RATE, gains)
    return with_parameters(node, **finite) if finite else node


def _wires(nodes: Nodes, edges: Edges, convention: Convention) -> Convention:
    """Apply the options to these nodes, some of which are replaced."""
    loops = _recurrent(nodes, edges)
    recurrent = {name for name in loops if isinstance(nodes[name], nir.CubaLIF)}
    current_based = {name for name, node in nodes.items() if isinstance(node, nir.CubaLIF)}
    reset = convention.reset
    if recurrent and reset in ("zero", "subtract"):
        # its RSynaptic computes the reset of reset_delay=False, and keeps what was before it
        if reset == "zero" and current_based | loops == recurrent:
            reset = "zero-delayed"  # after which a Leaky fires alike
        elif reset == "subtract" and all(
            name in recurrent for name, node in nodes.items() if isinstance(node, SPIKING)
        ):
            reset = "subtract-delayed"
        else:
            late = "resets an RSynaptic one timestep later even with reset_delay=False, and other "
            require(False, min(recurrent), f"{late}layers here at once, which no option says")
        convention = replace(convention, reset=reset)
    if reset == "subtract":
        # where the threshold is not below 0; reset_delay=False, see runtime.float_model
        return replace(convention, reset="subtract-ahead")
    # without a leak it is the same whether a threshold is taken off before or after a decay
    if convention.reset == "subtract-delayed" and _all_integrate(nodes):
        return replace(convention, reset="subtract")
    if reset != "zero-delayed":
        return convention
    for name in loops - recurrent:
        # an RLeaky loses the input of that timestep, as a CubaLIF does: one without a current
        node = nodes[name]
        tau = node.tau if isinstance(node, nir.LIF) else np.full(node.r.shape, _ENDLESS)
        unit = np.full(node.r.shape, convention.dt)
        nodes[name] = with_gain(
            nir.CubaLIF(unit, tau, unit, 0 * unit, node.v_threshold, node.v_reset, unit), convention
        )
    # b V is 0 after either: a Leaky fires alike
    late_matters = current_based or loops
    return convention if late_matters else replace(convention, reset="zero")


def _recurrent(nodes: Nodes, edges: Edges) -> set[str]:
    """Neurons of RLeaky and RSynaptic: those in a loop with a node of weights."""
    return {
        source
        for source, target in edges
        if isinstance(nodes[source], SPIKING) and (target, source) in edges
    }


def _all_integrate(nodes: Nodes) -> bool:
    """True if all neurons are IF with thresholds from 0 on, so that none begins with a reset."""
    spiking = [node for node in nodes.values() if isinstance(node, SPIKING)]
    return bool(spiking) and all(
        isinstance(node, nir.IF) and (node.v_threshold >= 0).all() for node in spiking
    )


def _arrange(nodes: Nodes, edges: EdgeList) -> tuple[Nodes, EdgeList]:
    """The graph with a node more, which changes nothing, in each loop of a neuron and weights.

    snnTorch 1.0.0 wraps such loops, and nirtorch 2.6 cannot run what comes of it; it runs a loop of
    three nodes.
    """
    nodes, kept = dict(nodes), set(edges)
    for source, target in sorted(edges):
        if isinstance(nodes[source], SPIKING) and (target, source) in edges:
            between = f"{target}_in"
            while between in nodes:
                between += "_"
            nodes[between] = nir.Linear(np.eye(nodes[source].v_threshold.size))
            kept = kept - {(source, target)} | {(source, between), (between, target)}
    return nodes, sorted(kept)


SNNTORCH = Preset(
    tool=_TOOL,
    kinds=(*_MAPS, nir.IF, nir.LIF, nir.CubaLIF),
    convention=lambda nodes: Convention(1e-4),
    translate=_reads,
    source="snntorch 1.0.0, import_nir.py: dt, reset_mechanism and reset_delay are constants there",
)
SNNTORCH_WRITER = Writer(
    tool=_TOOL,
    kinds=(*_MAPS, nir.IF, nir.LIF, nir.CubaLIF),
    # its neurons have decay factors and no dt; its export writes r = tau/dt with 1e-4
    timestep=tau_over_r,
    default_timestep=(1e-4, ""),
    contradiction=f", which {_TOOL} writes whatever its network was trained with; its "
    "decays count timesteps",
    translate=_means,
    wire=_wires,
    finite=_finite,
    source="snntorch 1.0.0, export_nir.py, _neurons/leaky.py and _neurons/synaptic.py",
    open={
        "reset": Assumption(
            ("subtract-delayed", "zero", "subtract", "zero-delayed", "none"),
            "reset by subtraction, delayed, snnTorch's default (--reset zero or subtract if yours "
            "had reset_delay=False, zero-delayed or none if it had that reset_mechanism)",
        )
    },
    always=("graded_spikes_factor 1, no inhibition and no state_quant",),
)

SNNTORCH_IMPORTER = Importer(arrange=_arrange)
