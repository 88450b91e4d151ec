"""Other libraries running the networks of lab.bench.nets, as their users run them.

Each takes spikes in a form of its own, which is made before the clock starts, and gives those of
the last layer, (T, B, N). Weights are divided by the threshold, so that all thresholds are 1.
"""

from collections.abc import Callable, Iterator
from importlib.util import find_spec
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from lab.bench.nets import Net, Raster


class Peer(NamedTuple):
    """A network of a library.

    run: from prepared spikes to those of the last layer.
    prepare: from a raster (B, T, M) to what it takes.
    """

    run: Callable[[Any], Any]
    prepare: Callable[[Raster], Any]


def peers(net: Net, batch: int) -> Iterator[tuple[str, Peer | str]]:
    """Name and network of each library, or why it is missing."""
    for name, make in TABLE.items():
        if find_spec(name) is None:
            yield name, "is not installed"
        elif name == "xylosim" and batch > 1:
            yield name, "runs one network at a time"
        else:
            yield name, make(net)


def tensor(raster: Raster) -> Tensor:
    """Spikes (T, B, M) as torch wants them."""
    return torch.from_numpy(np.ascontiguousarray(raster.swapaxes(0, 1))).float()


def snntorch_loop(net: Net) -> Peer:
    """A module for each layer, called once in every timestep."""
    from snntorch import Leaky, Synaptic

    reset = {"reset_mechanism": "zero", "reset_delay": False}
    spiking = [
        Synaptic(net.alpha, net.beta, **reset) if net.alpha else Leaky(net.beta, **reset)
        for _ in net.weights
    ]
    dense = [linear(net, k) for k in range(len(net.weights))]

    @torch.no_grad()
    def run(raster: Tensor) -> Any:  # noqa: ANN401
        states = [layer.reset_mem() for layer in spiking]
        states = [state if isinstance(state, tuple) else (state,) for state in states]
        rows = []
        for row in raster:
            for k, (weigh, layer) in enumerate(zip(dense, spiking, strict=True)):
                row, *states[k] = layer(weigh(row), *states[k])
            rows.append(row)
        return torch.stack(rows)

    return Peer(run, tensor)


def norse_layers(net: Net) -> Peer:
    """All timesteps of a layer, then the next layer; its Euler step weighs currents by 1 - beta."""
    from norse.torch import LIF, LIFParameters

    dt = 1e-3
    parameters = LIFParameters(
        tau_syn_inv=torch.as_tensor((1 - net.alpha) / dt),
        tau_mem_inv=torch.as_tensor((1 - net.beta) / dt),
    )
    layers = []
    for k in range(len(net.weights)):
        layers += [linear(net, k, 1 / (1 - net.beta)), LIF(parameters, dt=dt)]

    @torch.no_grad()
    def run(raster: Tensor) -> Any:  # noqa: ANN401
        for k, layer in enumerate(layers):
            raster = layer(raster)[0] if k % 2 else layer(raster)
        return raster

    return Peer(run, tensor)


def spikingjelly_layers(net: Net) -> Peer:
    """All timesteps of a layer, then the next layer; LIF neurons, which have no current."""
    from spikingjelly.activation_based import functional
    from spikingjelly.activation_based.neuron import LIFNode

    modules: list[nn.Module] = []
    for k in range(len(net.weights)):
        neurons = LIFNode(tau=1 / (1 - net.beta), decay_input=False, step_mode="m")
        modules += [linear(net, k), neurons]
    network = nn.Sequential(*modules).eval()

    @torch.no_grad()
    def run(raster: Tensor) -> Any:  # noqa: ANN401
        functional.reset_net(network)
        return network(raster)

    return Peer(run, tensor)


def xylosim_layer(net: Net) -> Peer:
    """The C++ simulator of Xylo: hidden layers are its recurrent neurons; rates are not matched.

    A Xylo has room for fewer inputs and outputs; the simulator has no such limit.
    """
    from xylosim.v2 import XyloLayer, XyloSynapse

    first, *between, last = net.weights
    hidden = first.shape[1] + sum(weight.shape[1] for weight in between)

    def synapses(weight: NDArray[np.int16], target: int) -> list[list[Any]]:
        return [
            [XyloSynapse(target + n, 0, int(w)) for n, w in enumerate(row) if w] for row in weight
        ]

    target, recurrent = 0, []
    for weight in between:
        target += weight.shape[0]
        recurrent += synapses(weight, target)
    recurrent += [[] for _ in range(hidden - len(recurrent))]
    outgoing = [[] for _ in range(hidden - len(last))] + synapses(last, 0)
    incoming = synapses(first, 0)
    size_of = [weight.shape[1] for weight in net.weights[:-1]]
    threshold = np.repeat([int(t) for t in net.thresholds[:-1]], size_of).tolist()
    outputs = last.shape[1]
    layer = XyloLayer(
        synapses_in=incoming, synapses_rec=recurrent, synapses_out=outgoing,
        aliases=[[] for _ in range(hidden)],
        threshold=threshold, threshold_out=[int(net.thresholds[-1])] * outputs,
        has_bias=False, bias=[0] * hidden, bias_out=[0] * outputs,
        weight_shift_inp=0, weight_shift_rec=0, weight_shift_out=0,
        dash_mem=[2] * hidden, dash_mem_out=[2] * outputs,
        dash_syns=[[1, 1]] * hidden, dash_syns_out=[[1]] * outputs, name="benchmark",
    )  # fmt: skip
    # the simulator holds bare pointers to them
    kept = (incoming, recurrent, outgoing)

    def run(raster: list[list[int]]) -> Any:  # noqa: ANN401
        layer.reset_all()
        return kept and layer.evolve(raster)

    return Peer(run, lambda raster: raster[0].tolist())


def linear(net: Net, k: int, gain: float = 1.0) -> nn.Linear:
    """Layer k's weights."""
    weight = net.weights[k].T.astype(np.float32) * gain / net.thresholds[k]
    layer = nn.Linear(weight.shape[1], weight.shape[0], bias=False)
    layer.load_state_dict({"weight": torch.from_numpy(np.ascontiguousarray(weight))})
    return layer


TABLE: dict[str, Callable[[Net], Peer]] = {
    "snntorch": snntorch_loop,
    "norse": norse_layers,
    "spikingjelly": spikingjelly_layers,
    "xylosim": xylosim_layer,
}
