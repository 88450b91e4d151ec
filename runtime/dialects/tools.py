"""The tools: how each reads a NIR file, the meaning of those it wrote, and what it accepts.

A tool is a block of this file, or a file of its own: its import, its export, and what its import
accepts. Imports were compared with the tools themselves, and the exports of snnTorch, Norse and
SpikingJelly; those of Lava, Rockpool and sinabs are read in their source and worked out by hand.
"""

from collections.abc import Container
from typing import Any

import nir
import numpy as np

from spikedeploy.runtime.convention import Convention, Floor
from spikedeploy.runtime.dialects.dialect import (
    Assumption,
    EdgeList,
    Edges,
    Importer,
    Nodes,
    Preset,
    Values,
    Writer,
    are_integrators,
    counted_from,
    is_close,
    is_uniform,
    one_minus_decay,
    require,
    require_values,
    rounded_to,
    tau_over_r,
    with_batch_axis,
    with_gain,
    with_parameters,
    with_zero_reset,
    without_padding,
)
from spikedeploy.runtime.dialects.snntorch_import import (
    SNNTORCH,
    SNNTORCH_IMPORTER,
    SNNTORCH_WRITER,
)
from spikedeploy.runtime.errors import ConventionError
from spikedeploy.runtime.graph.discretisation import SPIKING, DiscreteNeuron, float64
from spikedeploy.runtime.graph.order import order

# Lava: its import in the NIR paper; its export by lava_to_nir.py, for the .net files of lava-dl

_LAVA_KINDS = (nir.Affine, nir.Linear, nir.CubaLIF)


def _lava_reads(name: str, node: nir.NIRNode, convention: Convention) -> nir.NIRNode:
    if isinstance(node, nir.Affine):
        require(np.abs(node.bias) <= 1e-8, name, "reads no bias of an Affine")
    require_values(name, node, "needs", v_leak=0)
    if isinstance(node, nir.LIF):
        # the import scales the weights before it by dt/tau and ignores r
        return with_zero_reset(node, r=np.ones(node.r.shape))
    if not isinstance(node, nir.CubaLIF):
        return node
    unit = is_close(node.r, float64(node.tau_mem) / convention.dt)
    require(unit, name, "needs r = tau_mem/dt")
    return with_zero_reset(node)


def _lava_means(name: str, node: nir.NIRNode, convention: Convention) -> nir.NIRNode:
    if isinstance(node, nir.Affine):
        no_network = "divides weights by 64 and not biases, which is no network that ran"
        require(node.bias == 0, name, f"{no_network}: biases must be 0")
    require_values(name, node, "writes", v_leak=0)
    if not isinstance(node, nir.CubaLIF):
        return node
    return with_gain(with_zero_reset(node), convention)


_LAVA = Preset(
    tool="Lava 0.10.0 (float)",
    kinds=(*_LAVA_KINDS, nir.LIF),
    convention=lambda nodes: Convention(1e-4, delay=1),
    options=("dt",),
    translate=_lava_reads,
    source="github.com/neuromorphs/NIR paper/nir_to_lava.py; a Dense has a delay of one timestep",
)
_LAVA_WRITER = Writer(
    tool="Lava (lava_to_nir.py)",
    kinds=_LAVA_KINDS,
    # decays of a Loihi neuron have no dt; the script writes tau = dt/decay with 1e-4
    timestep=tau_over_r,
    translate=_lava_means,
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


# Nengo, as the NIR paper's import configures it; it has no import of its own, and no export


def _nengo_convention(nodes: Nodes) -> Convention:
    """nengo.LIF clips its membrane at 0; the paper's IF does not."""
    mixture = "floors the membranes of LIF and not those of IF, and the graph has both"
    floor: Floor = "none" if are_integrators(nodes, mixture) else "zero"
    return Convention(1e-3, integrator="exponential", floor=floor)


def _nengo_reads(name: str, node: nir.NIRNode, convention: Convention) -> nir.NIRNode:
    if isinstance(node, (nir.LIF, nir.IF)):
        require_values(name, node, "needs", r=1)
    require_values(name, node, "needs", v_leak=0)
    if isinstance(node, nir.IF):
        # its import writes a gain of 1/dt, which the neuron multiplies by dt
        return with_zero_reset(node, r=np.full(node.r.shape, 1 / convention.dt))
    if isinstance(node, nir.LIF):
        require(is_uniform(node.tau), name, "takes the tau of the first neuron for all")
        return with_zero_reset(node)
    if not isinstance(node, nir.CubaLIF):
        return node
    # its synapse decays by 1 - dt/tau_syn in a timestep, its membrane by exp(-dt/tau_mem)
    for field in ("r", "v_threshold", "tau_syn", "tau_mem"):
        require(is_uniform(getattr(node, field)), name, f"needs one {field} for all neurons")
    step = convention.dt / float64(node.tau_syn)
    require(step < 1, name, "needs tau_syn above dt")
    return with_zero_reset(node, tau_syn=-convention.dt / np.log1p(-step))


def _nengo_wires(nodes: Nodes, edges: Edges, convention: Convention) -> None:
    """Amplify the spikes of a LIF by 1/dt, and delay the input of a CubaLIF, a lowpass, by dt."""
    for name, node in sorted(nodes.items()):
        if isinstance(node, nir.LIF):
            after = f"{name}.amplitude"
            nodes[after] = nir.Scale(np.full(node.r.shape, 1 / convention.dt))
            moved = {edge: (after, edge[1]) for edge in edges if edge[0] == name}
            new = (name, after)
        elif isinstance(node, nir.CubaLIF):
            before = f"{name}.synapse"
            nodes[before] = nir.Delay(np.full(node.r.shape, convention.dt))
            moved = {edge: (edge[0], before) for edge in edges if edge[1] == name}
            new = (before, name)
        else:
            continue
        edges.difference_update(moved)
        edges.update(moved.values(), [new])


_NENGO = Preset(
    tool="Nengo 4.1.0",
    kinds=(nir.Affine, nir.Linear, nir.IF, nir.LIF, nir.CubaLIF),
    convention=_nengo_convention,
    options=("dt",),
    translate=_nengo_reads,
    wire=_nengo_wires,
    source="github.com/neuromorphs/NIR paper/03_rnn/nir_to_nengo.py; nengo 4.1.0, neurons.py",
)


# Norse visits nodes depth first (nirtorch.load), along edges in the order of the file; the node
# that it visits last is its output. A node with several sources runs when the first of them did.

_NORSE_TOOL = "Norse 1.1.0"
_NORSE_KINDS = (
    nir.Affine, nir.Linear, nir.Conv2d, nir.Flatten, nir.SumPool2d, nir.IF, nir.LIF, nir.CubaLIF,
)  # fmt: skip


def _norse_reads(name: str, node: nir.NIRNode, convention: Convention) -> nir.NIRNode:
    if isinstance(node, nir.Flatten):
        return with_batch_axis(node)
    if isinstance(node, nir.SumPool2d):
        return without_padding(node)
    if isinstance(node, (nir.IF, nir.LIF)):
        only = "subtracts after spikes of CubaLIF only"
        require(convention.reset == "zero", name, only)
        # it ignores r, with a warning; an IF adds its input whatever dt is
        r = 1 / convention.dt if isinstance(node, nir.IF) else 1.0
        own = with_zero_reset(node, r=np.full(node.r.shape, r))
        return own if isinstance(node, nir.IF) else counted_from(own, float64(node.v_leak))
    if isinstance(node, nir.CubaLIF):
        require(node.v_leak == 0, name, "would add v_leak to the synapse as well")
        return with_zero_reset(node)
    return node


def _norse_means(name: str, node: nir.NIRNode, convention: Convention) -> nir.NIRNode:
    """The neuron with its own time constants; files hold dt/tau_inv, tau times the dt of to_nir."""
    dt = convention.dt
    require_values(name, node, "writes", r=1)
    if isinstance(node, nir.LI):
        starts = "starts membranes at v_leak, and nothing counts the output of an LI from there"
        require(node.v_leak == 0, name, starts)
        return with_parameters(node, tau=rounded_to(dt, float64(node.tau) / dt))
    if isinstance(node, nir.LIF):
        own = with_parameters(node, tau=rounded_to(dt, float64(node.tau) / dt))
        return counted_from(own, float64(node.v_leak))
    if isinstance(node, nir.CubaLIF):
        if convention.reset == "subtract":
            raise ConventionError(
                f"node {name!r}: reset 'subtract': an LIFCell of {_NORSE_TOOL} resets to "
                "v_reset, only an LIFBoxCell can subtract. Leave --reset away."
            )
        tau_syn = rounded_to(dt, float64(node.tau_syn) / dt)
        tau_mem = rounded_to(dt, float64(node.tau_mem) / dt)
        # the input is added to the current whole
        own = with_parameters(node, tau_syn=tau_syn, tau_mem=tau_mem, w_in=tau_syn / dt)
        return counted_from(own, float64(node.v_leak))
    if isinstance(node, nir.IF):
        # the input is added whatever dt is
        return with_parameters(node, r=np.full(node.r.shape, 1 / dt))
    return node


def _norse_finish(node: nir.NIRNode, neuron: DiscreteNeuron) -> nir.NIRNode:
    """Return the neurons with r = 1: Norse ignores r, and we do not."""
    return with_parameters(node, r=np.ones_like(node.tau)) if isinstance(node, nir.LIF) else node


def _norse_arrange(nodes: Nodes, edges: EdgeList) -> tuple[Nodes, EdgeList]:
    """The graph, if need be with names that sort as it must be visited: what returns comes first.

    Raises ConventionError where no names do.
    """
    if _is_right(norse_visits(nodes, sorted(edges)), nodes, edges):
        return nodes, sorted(edges)
    output = next(name for name, node in nodes.items() if isinstance(node, nir.Output))
    wanted = norse_visits(nodes, sorted(edges), output)
    if not _is_right(wanted, nodes, edges):
        raise ConventionError(
            "it runs a node when the first of its sources did, and a node here waits for more"
        )
    names = {name: f"n{index:03}_{name}" for index, name in enumerate(wanted)}
    again = {names[name]: nodes[name] for name in wanted}
    return again, sorted((names[source], names[target]) for source, target in edges)


def norse_visits(nodes: Nodes, edges: EdgeList, output: str = "") -> list[str]:
    """Nodes as Norse runs them; with `output`, its branch is the last at each node."""
    found: dict[str, None] = {}
    waiting = [name for name, node in nodes.items() if isinstance(node, nir.Input)][:1]
    while waiting:
        name = waiting.pop()
        if name not in found:
            found[name] = None
            targets = [target for source, target in edges if source == name]
            if output:
                targets.sort(key=lambda target: output in _reached(target, edges, found))
            waiting += reversed(targets)
    return list(found)


def _reached(name: str, edges: EdgeList, without: Container[str]) -> set[str]:
    """Nodes that paths from this one lead to, past those that are left out."""
    found: set[str] = set()
    new = {name}
    while new := {each for each in new if each not in without} - found:
        found |= new
        new = {target for source, target in edges if source in new}
    return found


def _is_right(visited: list[str], nodes: Nodes, edges: EdgeList) -> bool:
    """True if the Output comes last, and as many edges lead back as loops need."""
    at = {name: index for index, name in enumerate(visited)}
    if at.keys() != nodes.keys() or not isinstance(nodes[visited[-1]], nir.Output):
        return False
    back = sum(at[source] >= at[target] for source, target in edges)
    return back == len(order(nir.NIRGraph(nodes, edges, type_check=False)).late)


_NORSE = Preset(
    tool=_NORSE_TOOL,
    kinds=_NORSE_KINDS,
    convention=lambda nodes: Convention(1e-3),
    options=("dt", "reset"),
    translate=_norse_reads,
    source="norse 1.1.0, torch/utils/import_nir.py and torch/functional/lif_box.py",
)
_NORSE_WRITER = Writer(
    tool=_NORSE_TOOL,
    kinds=(nir.Affine, nir.Conv2d, nir.LIF, nir.CubaLIF, nir.LI, nir.IF),
    timestep=lambda name, node: None,
    default_timestep=(
        1e-3,
        "dt = 0.001 s of neurons and of to_nir, Norse's default (--dt if yours was another)",
    ),
    translate=_norse_means,
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
_NORSE_IMPORTER = Importer(
    uniform=False,
    resets=("zero", "subtract"),
    # r = 1, which is all that it knows, gives a LIF this gain
    gain=lambda kind, neuron: (
        1 - neuron.membrane_decay if kind is nir.LIF else np.ones_like(neuron.gain)
    ),
    finish=_norse_finish,
    arrange=_norse_arrange,
)


# Rockpool: I = a (I + x); V = b V + I, and its import adds v_leak, a bias, to V

_ROCKPOOL_TOOL = "Rockpool 3.1.0"
_ROCKPOOL_SOURCE = "rockpool 3.1.0, nn/modules/torch/nir.py and lif_torch.py"
_ROCKPOOL_KINDS = (nir.Affine, nir.Linear, nir.CubaLIF)


def _rockpool_timestep(node: nir.CubaLIF) -> float:
    """The dt [s] that its import gives a layer; its export writes r = tau exp(-dt/tau)/dt."""
    with np.errstate(divide="ignore", invalid="ignore"):  # r of -1 is refused by name
        return float((float64(node.tau_mem) / (1 + float64(node.r))).min())


def _rockpool_convention(nodes: Nodes) -> Convention:
    steps = {
        n: _rockpool_timestep(node) for n, node in nodes.items() if isinstance(node, nir.CubaLIF)
    }
    if not steps:
        raise ConventionError(
            f"{_ROCKPOOL_TOOL} takes its timestep from r of CubaLIF nodes, and there are none. "
            "Read the file without the preset."
        )
    for name, dt in sorted(steps.items()):
        finite = "takes dt = tau_mem/(1 + r), which is not above 0 and finite"
        require(0 < dt < np.inf, name, finite)
    return Convention(min(steps.values()), "subtract", "exponential", spikes="many")


def _rockpool_reads(name: str, node: nir.NIRNode, convention: Convention) -> nir.NIRNode:
    if not isinstance(node, nir.CubaLIF):
        return node
    # it ignores r and w_in; layers of different dt are stepped together, so their time constants
    # are scaled
    stretch = convention.dt / _rockpool_timestep(node)
    tau_syn, tau_mem = stretch * float64(node.tau_syn), stretch * float64(node.tau_mem)
    leak = float64(node.v_leak) / one_minus_decay(tau_mem, convention)
    own = with_zero_reset(node, tau_syn=tau_syn, tau_mem=tau_mem, v_leak=leak)
    return with_gain(own, convention, np.exp(-convention.dt / tau_syn))


def _rockpool_stated_timestep(name: str, node: nir.NIRNode) -> Any:  # noqa: ANN401
    """The dt [s] for which r = tau exp(-dt/tau)/dt: u = dt/tau has u exp(u) = 1/r."""
    if not isinstance(node, nir.CubaLIF):
        return None
    require(node.r > 0, name, "writes r = tau exp(-dt/tau)/dt, above 0")
    x = 1 / float64(node.r)
    u = np.log1p(x)  # Lambert's W, by Newton's method
    for _ in range(50):
        u = u - (u * np.exp(u) - x) / (np.exp(u) * (1 + u))
    return float64(node.tau_mem) * u


def _rockpool_means(name: str, node: nir.NIRNode, convention: Convention) -> nir.NIRNode:
    if not isinstance(node, nir.CubaLIF):
        return node
    require_values(name, node, "writes", v_leak=0)
    decayed = np.exp(-convention.dt / float64(node.tau_syn))
    return with_gain(with_zero_reset(node), convention, decayed)


def _rockpool_finish(node: nir.NIRNode, neuron: DiscreteNeuron) -> nir.NIRNode:
    """The neurons with the r from which it takes dt, and a w_in that it ignores and we do not."""
    if neuron.current_decay is None:
        return node
    a, b, r = neuron.current_decay, neuron.membrane_decay, node.r - 1
    return with_parameters(node, r=r, w_in=a / ((1 - a) * (1 - b) * r))


def _rockpool_gain(kind: type[nir.NIRNode], neuron: DiscreteNeuron) -> Values:
    return np.ones_like(neuron.gain) if neuron.current_decay is None else neuron.current_decay


_ROCKPOOL = Preset(
    tool=_ROCKPOOL_TOOL,
    kinds=_ROCKPOOL_KINDS,
    convention=_rockpool_convention,
    remark="dt = tau_mem/(1 + r) of each layer",
    translate=_rockpool_reads,
    source=_ROCKPOOL_SOURCE,
)
_ROCKPOOL_WRITER = Writer(
    tool=_ROCKPOOL_TOOL,
    kinds=_ROCKPOOL_KINDS,
    timestep=_rockpool_stated_timestep,
    tolerance=1e-4,
    translate=_rockpool_means,
    source=_ROCKPOOL_SOURCE,
    fixed={"integrator": "exponential", "reset": "subtract", "spikes": "many"},
    always=("no bias of LIFTorch and no recurrent weights, which to_nir leaves out",),
)
_ROCKPOOL_IMPORTER = Importer(
    uniform=False,
    resets=("subtract",),
    convention=lambda own: Convention(own.dt, "subtract", "exponential", spikes="many"),
    gain=_rockpool_gain,
    finish=_rockpool_finish,
)


# sinabs: time constants are in timesteps; only integrators have a floor

_SINABS_TOOL = "sinabs 3.1.3"
_SINABS_KINDS = (
    nir.Affine, nir.Conv1d, nir.Conv2d, nir.SumPool2d, nir.Flatten, nir.LI, nir.IF, nir.LIF,
)  # fmt: skip


def _sinabs_convention(nodes: Nodes) -> Convention:
    mixture = "floors the membranes of IF and not those of LIF, and the graph has both"
    floor: Floor = "threshold" if are_integrators(nodes, mixture) else "none"
    return Convention(1.0, "subtract", "exponential", spikes="many", floor=floor)


def _sinabs_reads(name: str, node: nir.NIRNode, convention: Convention) -> nir.NIRNode:
    if isinstance(node, nir.SumPool2d):
        return without_padding(node)
    if not isinstance(node, (nir.IF, nir.LIF, nir.LI)):
        return node
    require_values(name, node, "needs", v_leak=0)
    # norm_input is False: the input has gain 1, and r is ignored
    unit = with_gain(node, convention)
    if isinstance(node, nir.LI):
        require_values(name, node, "needs", r=1)
        return unit
    return with_zero_reset(unit)


def _sinabs_means(name: str, node: nir.NIRNode, convention: Convention) -> nir.NIRNode:
    require_values(name, node, "writes", r=1, v_leak=0)
    # norm_input is False by default in ExpLeak, and True in LIF, where r = 1 is right
    return with_gain(node, convention) if isinstance(node, nir.LI) else node


_SINABS = Preset(
    tool=_SINABS_TOOL,
    kinds=_SINABS_KINDS,
    convention=_sinabs_convention,
    remark="tau in timesteps",
    translate=_sinabs_reads,
    source="sinabs 3.1.3, nir.py, layers/functional/lif.py and activation/spike_generation.py",
)
_SINABS_WRITER = Writer(
    tool=_SINABS_TOOL,
    kinds=_SINABS_KINDS,
    timestep=lambda name, node: 1.0,
    contradiction=f": {_SINABS_TOOL} counts its time constants in timesteps, and writes them so",
    translate=_sinabs_means,
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


# SpikingJelly

_SPIKINGJELLY_TOOL = "SpikingJelly 2.0.0"
_SPIKINGJELLY_KINDS = (
    nir.Affine, nir.Linear, nir.Conv1d, nir.Conv2d, nir.AvgPool2d, nir.Flatten, nir.IF, nir.LIF,
    nir.CubaLIF,
)  # fmt: skip
_CLOSE = 1e-6  # relative, by which its import compares


def _spikingjelly_reads(name: str, node: nir.NIRNode, convention: Convention) -> nir.NIRNode:
    """The node, counted from v_reset: it refuses every other that it would compute differently."""
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
    # where its membranes start
    return counted_from(node, float64(node.v_reset)) if isinstance(node, SPIKING) else node


def _spikingjelly_timestep(name: str, node: nir.NIRNode) -> Any:  # noqa: ANN401
    """The dt in r = 1/dt or tau/dt; None of a LIFNode with decay_input, whose r is 1."""
    if isinstance(node, nir.IF):
        return 1 / float64(node.r)
    decays_input = isinstance(node, nir.LIF) and is_close(node.r, 1.0).all()
    return None if decays_input else tau_over_r(name, node)


def _spikingjelly_means(name: str, node: nir.NIRNode, convention: Convention) -> nir.NIRNode:
    if not isinstance(node, SPIKING):
        return node
    if isinstance(node, nir.CubaLIF):
        require_values(name, node, "writes", v_leak=0)
    elif isinstance(node, nir.LIF):
        same = is_close(node.v_leak, float64(node.v_reset))
        require(same, name, "writes v_leak = v_reset")
        node = with_parameters(node, v_leak=node.v_reset)
    own = counted_from(node, float64(node.v_reset))  # where its membranes start
    return own if _spikingjelly_timestep(name, node) is None else with_gain(own, convention)


_SPIKINGJELLY = Preset(
    tool=_SPIKINGJELLY_TOOL,
    kinds=_SPIKINGJELLY_KINDS,
    convention=lambda nodes: Convention(1e-4, spikes="reached"),
    options=("dt",),
    translate=_spikingjelly_reads,
    source="spikingjelly 2.0.0, activation_based/nir_exchange/from_nir.py and surrogate.heaviside",
)
_SPIKINGJELLY_WRITER = Writer(
    tool=_SPIKINGJELLY_TOOL,
    kinds=_SPIKINGJELLY_KINDS,
    timestep=_spikingjelly_timestep,
    default_timestep=(
        1e-4,
        "dt = 0.0001 s of export_to_nir, its default (--dt if yours was another)",
    ),
    translate=_spikingjelly_means,
    source="spikingjelly 2.0.0, activation_based/nir_exchange/to_nir.py and neuron/lif.py",
    # a soft reset is not exported
    fixed={"spikes": "reached"},
)


PRESETS: dict[str, Preset] = {
    "lava": _LAVA,
    "nengo": _NENGO,
    "norse": _NORSE,
    "rockpool": _ROCKPOOL,
    "sinabs": _SINABS,
    "snntorch": SNNTORCH,
    "spikingjelly": _SPIKINGJELLY,
}
WRITERS: dict[str, Writer] = {
    "lava": _LAVA_WRITER,
    "norse": _NORSE_WRITER,
    "rockpool": _ROCKPOOL_WRITER,
    "sinabs": _SINABS_WRITER,
    "snntorch": SNNTORCH_WRITER,
    "spikingjelly": _SPIKINGJELLY_WRITER,
}
IMPORTERS: dict[str, Importer] = {
    "norse": _NORSE_IMPORTER,
    "rockpool": _ROCKPOOL_IMPORTER,
    "snntorch": SNNTORCH_IMPORTER,
    "spikingjelly": Importer(v_reset=True),
}
