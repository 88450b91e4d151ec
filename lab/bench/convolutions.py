"""How fast convolutions run on Speck and Loihi, against other libraries on the same networks.

    python -m lab convolutions [--rounds 9] [--json]

One process, one thread. Networks of integrate-and-fire neurons with random weights are compiled for
the two chips and run by the compiled kernels, on Speck also event after event. The libraries get
the weights and the thresholds that Speck has. Inputs are spikes of independent pixels. Each
candidate takes the timesteps of a recording at once, in the form that it wants, with states reset
before; its time is divided by their number. Ours keep no ledger. Candidates take turns; a library
that is not installed is left out, with a line. sinabs needs nirtorch and pbr:
`pip install --no-deps sinabs==3.1.3 nirtorch pbr`.

sinabs computes what Speck does in timesteps, and its spikes are compared. snnTorch spikes once a
timestep at most, and Norse resets to 0: only their speed is compared.
"""

from collections.abc import Callable
from importlib.util import find_spec
from itertools import pairwise
from typing import Any, NamedTuple

import nir
import numpy as np
import torch
from torch import Tensor, nn

from lab.bench.nets import Raster, bernoulli
from lab.bench.peers import Peer, tensor
from lab.bench.runtime import calls
from lab.bench.turns import medians, parser_of, report
from spikedeploy.runtime.artifact.artifact import Artifact
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.chips.layer import Layer
from spikedeploy.runtime.compiler.compile import compile_program
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.emulator.machine import Machine

DT, TIMESTEPS, RECORDINGS = 1e-3, 10, 3
RATES = (0.01, 0.05)  # spikes of a pixel and polarity in a timestep


class Convolution(NamedTuple):
    """A convolution behind a sum pool, and its neurons; a kernel of 0 sees everything."""

    features: int
    kernel: int = 3
    stride: int = 1
    padding: int = 1
    pool: int = 1


_PAPER = (
    Convolution(16, 5, 2), Convolution(16), Convolution(8, pool=2), Convolution(256, 0, pool=2),
    Convolution(10, 0),
)  # fmt: skip
_GESTURES = (Convolution(8, stride=2), Convolution(16), Convolution(16, pool=2), Convolution(11, 0))
# extents of the two square maps of the input, and layers; the first is the network for N-MNIST of
# the NIR paper (Pedersen 2024)
NETWORKS = {
    "NIR paper's CNN": (34, _PAPER),
    "gestures 64 x 64": (64, _GESTURES),
    "gestures 128 x 128": (128, _GESTURES),
}
# standard deviation of the weights times the root of the fan-in, for thresholds of 1: the first
# layers then spike about as often as the input
GAIN = 2.0
_SPECK = Convention(DT, "subtract", spikes="reached", floor="threshold")
CHIPS = {
    "speck2f": _SPECK,
    "speck2f:queue=on": _SPECK,  # event after event
    "loihi1": Convention(DT),
}


def main() -> None:
    """Measure, and print tables or JSON."""
    arguments = parser_of(__doc__, 9).parse_args()
    torch.set_num_threads(1)
    result: dict[str, Any] = {}
    for name, (extent, layers) in NETWORKS.items():
        graph = build(extent, layers)
        # their fully connected layers have more axons than chips have room for
        compiled = {
            of_chip: compile_program(Artifact(graph, None, convention), chip(of_chip), limits=False)
            for of_chip, convention in CHIPS.items()
        }
        result[name] = {}
        for rate in RATES:
            raster = bernoulli(RECORDINGS, TIMESTEPS, 2 * extent**2, rate)
            result[name][f"{rate:.0%} of inputs"] = compare(compiled, raster, arguments.rounds)
    report(result, arguments)


def build(extent: int, layers: tuple[Convolution, ...], seed: int = 0) -> nir.NIRGraph:
    """A network on maps (2, extent, extent), as other libraries export it."""
    rng = np.random.default_rng(seed)
    shape: tuple[int, ...] = (2, extent, extent)
    nodes: dict[str, nir.NIRNode] = {"input": nir.Input(np.array(shape))}
    for k, (features, kernel, stride, padding, pool) in enumerate(layers):
        if pool > 1:
            sides = np.full(2, pool)
            nodes[f"pool{k}"] = nir.SumPool2d(sides, sides, np.zeros(2, int))
            shape = (shape[0], shape[1] // pool, shape[2] // pool)
        if kernel:
            weight = rng.normal(size=(features, shape[0], kernel, kernel))
            weight *= GAIN / (shape[0] * kernel**2) ** 0.5
            bias = np.zeros(features)
            nodes[f"conv{k}"] = nir.Conv2d(shape[1:], weight, stride, padding, 1, 1, bias)
            side = (shape[1] + 2 * padding - kernel) // stride + 1
            shape = (features, side, side)
        else:
            seen = int(np.prod(shape))
            if len(shape) > 1:
                nodes[f"flat{k}"] = nir.Flatten({"input": np.array(shape)}, 0)
            nodes[f"dense{k}"] = nir.Linear(GAIN * rng.normal(size=(features, seen)) / seen**0.5)
            shape = (features,)
        nodes[f"layer{k}"] = nir.IF(np.full(shape, 1 / DT), np.ones(shape), np.zeros(shape))
    nodes["output"] = nir.Output(np.array(shape))
    return nir.NIRGraph(nodes, list(pairwise(nodes)))


def compare(compiled: dict[str, Program], raster: Raster, rounds: int) -> dict[str, Any]:
    """Medians of all candidates [ms per timestep], and what our chips count in a timestep.

    equal: whether Speck's spikes are those of sinabs.
    """
    recordings, timesteps = [raster[k : k + 1] for k in range(len(raster))], raster[..., 0].size
    candidates, operations, spikes, found = {}, {}, {}, {}
    for name, program in compiled.items():
        machine = Machine(program, len(raster), backend="numba")
        found[name], ledger = machine.infer(raster).copy(), machine.ledger
        operations[name] = ledger.total("sop") / timesteps
        sent = zip(ledger.by_layer("spike_out").values(), ledger.neurons, strict=True)
        spikes[name] = [n / timesteps / size for n, size in sent]
        candidates[name] = calls(Machine(program, 1, "none", backend="numba").infer, recordings)
    missing, equal = {}, None
    for name, neurons_of in NEURONS.items():
        if find_spec(name) is None:
            missing[name] = "is not installed"
            continue
        peer = network_of(compiled["speck2f"], neurons_of)
        prepared = [peer.prepare(one) for one in recordings]
        candidates[name] = calls(peer.run, prepared)
        if name == "sinabs":
            theirs = torch.stack([peer.run(one) for one in prepared])
            equal = bool((theirs.numpy() == found["speck2f"]).all())
    taken = medians(candidates, rounds)
    return {
        "median_ms": {name: us / 1e3 / raster.shape[1] for name, us in taken.items()},
        "operations": operations,
        "spikes_per_neuron": spikes,
        "equal": equal,
        "missing": missing,
    }


Advance = Callable[[Tensor], Tensor]
# a maker of the neurons of a layer at rest, and whether they take all timesteps at once
Neurons = tuple[Callable[[], Advance], bool]


def network_of(program: Program, neurons_of: Callable[[Layer], Neurons]) -> Peer:
    """The network of a library: synapses of torch for all timesteps at once, then its neurons."""
    layers = [(synapses_of(layer), *neurons_of(layer)) for layer in program.layers]

    @torch.no_grad()
    def run(rows: Tensor) -> Tensor:
        for weigh, make, takes_all in layers:
            sums, neurons = weigh(rows), make()
            rows = neurons(sums) if takes_all else torch.stack([neurons(each) for each in sums])
        return rows

    return Peer(run, lambda raster: tensor(raster)[:, 0])


def synapses_of(layer: Layer) -> Advance:
    """What a layer's weights make of spikes (T, M), in the shape of its neurons."""
    (synapses,) = layer.synapses
    weight, window = torch.from_numpy(synapses.weight.astype(np.float32)), synapses.window
    if window is None:
        return lambda rows: rows.flatten(1) @ weight
    if window.kernel == window.pooled[1:] and window.pool == (1, 1):
        return lambda rows: rows.flatten(1) @ weight.flatten(1).T

    def weigh(rows: Tensor) -> Tensor:
        maps = rows.reshape(len(rows), *window.source)
        if window.pool != (1, 1):
            maps = nn.functional.avg_pool2d(maps, window.pool, divisor_override=1)
        return nn.functional.conv2d(maps, weight, None, window.stride, window.padding)

    return weigh


def sinabs_neurons(layer: Layer) -> Neurons:
    """As many spikes as fit, and the floor that a Speck has."""
    from sinabs.layers import IAF

    threshold = float(layer.threshold[0])

    def make() -> Advance:
        neurons = IAF(spike_threshold=torch.tensor(threshold), min_v_mem=-threshold)
        return lambda sums: neurons(sums.flatten(1)[None])[0]

    return make, True


def snntorch_neurons(layer: Layer) -> Neurons:
    """One spike at most."""
    from snntorch import Leaky

    threshold = float(layer.threshold[0])
    return lambda: Leaky(1.0, threshold=threshold, init_hidden=True), False


def norse_neurons(layer: Layer) -> Neurons:
    """A spike resets the membrane to 0."""
    from norse.torch import IAF, IAFParameters

    neurons = IAF(IAFParameters(v_th=torch.tensor(float(layer.threshold[0]))))
    return lambda: lambda sums: neurons(sums)[0], True


NEURONS = {"sinabs": sinabs_neurons, "snntorch": snntorch_neurons, "norse": norse_neurons}
