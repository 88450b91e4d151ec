"""Networks for Speck beside sinabs' own: its DynapcnnNetwork in timesteps, and event by event.

`./spike test --peers sinabs` runs it. samna is never installed: what stands in for it here computes
nothing, and only lets sinabs' back-end be imported.
"""

import sys
from itertools import pairwise
from unittest.mock import MagicMock

import nir
import numpy as np
import pytest

from spikedeploy.runtime.artifact.artifact import Artifact
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.compiler.compile import check, compile_program
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.emulator.machine import Machine
from spikedeploy.runtime.families.integrate_and_fire.event_machine import EventMachine

sinabs = pytest.importorskip("sinabs")
torch = pytest.importorskip("torch")

_CHIPS = [
    f"samna.{each}{part}" for each in ("speck2e", "speck2f") for part in ("", ".configuration")
]
_SAMNA = ["samna", "samnagui", "samna.specksim", "samna.specksim.nodes", *_CHIPS]
for module in _SAMNA:
    sys.modules.setdefault(module, MagicMock(name=module))

from sinabs.activation import MembraneReset, MembraneSubtract, MultiSpike  # noqa: E402
from sinabs.backend.dynapcnn import DynapcnnNetwork  # noqa: E402
from sinabs.backend.dynapcnn.chips import Speck2FConfigBuilder  # noqa: E402
from sinabs.backend.dynapcnn.mapping import get_valid_mapping  # noqa: E402
from sinabs.layers import IAFSqueeze, SumPool2d  # noqa: E402

SEEDS = range(8)


class Network:
    """A random network as torch modules of sinabs, and the same as an artifact."""

    def __init__(self, seed, *, bias, channels=(2, 7), extent=(9, 15), depthwise=True):
        self.rng = rng = np.random.default_rng(seed)
        torch.manual_seed(seed)
        self.depthwise = depthwise
        self.reset = "zero" if seed % 4 == 3 else "subtract"
        self.floor = ("threshold", "zero")[seed % 2]
        self.shape = (2, *[int(rng.integers(*extent))] * 2)
        self.modules, self.nodes = [], {"input": nir.Input(np.array(self.shape))}
        shape, self.thinned = self.shape, 1
        for k in range(int(rng.integers(1, 4))):
            shape = self._convolve(k, shape, bias, int(rng.integers(*channels)))
            self.thinned = 1
            pool = int(rng.choice([1, 2])) if min(shape[1:]) > 3 else 1
            if pool > 1:
                averages = rng.random() < 0.5
                self.thinned = pool**2 if averages else 1
                made = torch.nn.AvgPool2d(pool) if averages else SumPool2d(pool)
                kind = nir.AvgPool2d if averages else nir.SumPool2d
                node = kind(np.array([pool] * 2), np.array([pool] * 2), np.array([0, 0]))
                self._add(f"p{k}", made, node)
                shape = (shape[0], shape[1] // pool, shape[2] // pool)
        if shape[1] == shape[2]:
            shape = self._connect(shape, bias)
        else:
            # sinabs makes of a linear map a kernel, and kernels are square
            shape = self._convolve("out", shape, bias, 5)
        self.nodes["output"] = nir.Output(np.array(shape))
        convention = Convention(
            1e-3, self.reset, spikes="many", floor=self.floor, state="kept", source="sinabs"
        )
        # nir 1.0.8 takes the channels of a depthwise kernel for those of its input
        graph = nir.NIRGraph(self.nodes, list(pairwise(self.nodes)), type_check=False)
        self.artifact = Artifact(graph, None, convention)
        self.sinabs = DynapcnnNetwork(
            torch.nn.Sequential(*self.modules), input_shape=self.shape, discretize=True
        )
        found = self.sinabs.dynapcnn_layers
        self.layers = [found[k] for k in sorted(found)]
        for layer in self.layers:
            # the constructor runs a batch
            layer.spk_layer.reset_states()
        self.names = [n for n, node in self.nodes.items() if isinstance(node, nir.IF)]

    def _connect(self, shape, bias):
        self.modules.append(torch.nn.Flatten())
        self.nodes["flat"] = nir.Flatten({"input": np.array(shape)}, 0, -1)
        dense = torch.nn.Linear(int(np.prod(shape)), 5, bias=bias)
        self._excite(dense, self.thinned)
        self._add("fc", dense, nir.Affine(dense.weight.detach().numpy(), self._bias(dense)))
        self._fire("out", (5,))
        return (5,)

    def _convolve(self, k, shape, bias, features):
        rng, kernel = self.rng, int(self.rng.integers(1, 4))
        stride, padding = (tuple(map(int, rng.integers(*ends, 2))) for ends in ((1, 3), (0, 3)))
        alone = self.depthwise and features % shape[0] == 0 and rng.random() < 0.5
        groups = shape[0] if alone else 1
        conv = torch.nn.Conv2d(shape[0], features, kernel, stride, padding, 1, groups, bias=bias)
        self._excite(conv, self.thinned)
        weight = conv.weight.detach().numpy()
        node = nir.Conv2d(shape[1:], weight, stride, padding, 1, groups, self._bias(conv))
        self._add(f"w{k}", conv, node)
        shape = tuple(conv(torch.zeros(1, *shape)).shape[1:])
        self._fire(f"n{k}", shape)
        return shape

    @staticmethod
    def _excite(module, thinned):
        """Weights with which an event brings about as much as a threshold, to all that hear it.

        thinned: spikes of which an average makes one.
        """
        weight = module.weight.data
        reached = weight[:, 0].numel() / np.prod(getattr(module, "stride", 1))
        reached /= getattr(module, "groups", 1)
        # no round numbers: sinabs scales in float32, where 127 / 0.4 is a tie
        module.weight.data = 0.2171 * weight / weight.abs().max() + 2 * thinned / reached
        if module.bias is not None:
            module.bias.data /= 5

    def _fire(self, name, shape):
        neurons = IAFSqueeze(
            batch_size=1,
            spike_threshold=1.0,
            spike_fn=MultiSpike,
            reset_fn=MembraneReset() if self.reset == "zero" else MembraneSubtract(),
            min_v_mem=-1.0 if self.floor == "threshold" else 0.0,
        )
        ones = np.ones(shape)
        self._add(name, neurons, nir.IF(1000 * ones, ones))

    def _add(self, name, module, node):
        self.modules.append(module)
        self.nodes[name] = node

    @staticmethod
    def _bias(module):
        out = module.weight.shape[0]
        return np.zeros(out) if module.bias is None else module.bias.detach().numpy()


def flat(tensor):
    return tensor.detach().numpy().reshape(-1).astype(np.int64)


@pytest.mark.parametrize("seed", SEEDS)
def test_timesteps_equal_dynapcnn_network_in_weights_counts_and_membranes(seed):
    network = Network(seed, bias=seed % 3 == 0)
    raster = (network.rng.random((24, *network.shape)) < 0.02).astype(np.uint8)
    raster *= network.rng.integers(1, 4, raster.shape, dtype=np.uint8)
    sent = {name: [] for name in network.names}
    held = {name: [] for name in network.names}

    def record(name):
        def hook(module, _, output):
            sent[name].append(flat(output))
            held[name].append(flat(module.v_mem))

        return hook

    for name, layer in zip(network.names, network.layers, strict=True):
        layer.spk_layer.register_forward_hook(record(name))
    program = compile_program(network.artifact, chip("speck2f"), limits=False)
    machine = Machine(program, trace=True, backend="interpreter")
    with torch.no_grad():
        for row in raster:
            network.sinabs(torch.tensor(row[None]).float())
    machine.infer(raster.reshape(1, len(raster), -1))
    for name in network.names:
        found = machine.recordings[name]
        np.testing.assert_array_equal(found.spikes[0], np.array(sent[name]))
        np.testing.assert_array_equal(found.membrane[0], np.array(held[name]))
    assert min(np.sum(sent[name]) for name in network.names) > 20


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("order", ["cyx", "yxc"])
def test_layers_that_hear_one_event_a_call_equal_events_in_order(seed, order):
    network = Network(seed, bias=False)
    on = chip("speck2f", queue="on", event_order=order, event_spikes="multi")
    machine = EventMachine(compile_program(network.artifact, on, limits=False), "auto")
    events = network.rng.integers(0, np.prod(network.shape), 400)
    found = machine.process(events)
    shapes = [network.shape, *(layer.get_neuron_shape() for layer in network.layers)]
    queue = [(e, *np.unravel_index(neuron, network.shape)) for e, neuron in enumerate(events)]
    pool = 1
    for k, (name, layer) in enumerate(zip(network.names, network.layers, strict=True)):
        expected, extents = [], layer.in_shape
        for cause, c, y, x in queue:
            if y // pool >= extents[1] or x // pool >= extents[2]:
                continue
            one = torch.zeros(1, *extents)
            one[0, c, y // pool, x // pool] = 1
            with torch.no_grad():
                spikes = layer.spk_layer(layer.conv_layer(one))[0].numpy().astype(int)
            turned = spikes if order == "cyx" else spikes.transpose(1, 2, 0)
            for place in np.argwhere(turned):
                at = tuple(place) if order == "cyx" else (place[2], place[0], place[1])
                expected += [(cause, *at)] * spikes[at]
        neurons = [np.ravel_multi_index(row[1:], shapes[k + 1]) for row in expected]
        assert found[name].neuron.tolist() == neurons
        assert found[name].cause.tolist() == [row[0] for row in expected]
        np.testing.assert_array_equal(machine.membrane[name], flat(layer.spk_layer.v_mem))
        queue, pool = expected, layer.pool[0][0]
    assert min(len(found[name].neuron) for name in network.names) > 20


@pytest.mark.parametrize("seed", range(12))
def test_memories_and_cores_are_those_of_sinabs(seed):
    network = Network(seed, bias=False, channels=(16, 70), extent=(16, 48), depthwise=False)
    found = check(network.artifact, chip("speck2f"))
    for name, layer in zip(network.names, network.layers, strict=True):
        placed, memory = found.mapping.of_neurons[name], layer.memory_summary()
        assert (placed.memory, placed.block) == (memory["kernel"], memory["neuron"])
    try:
        get_valid_mapping(dict(enumerate(network.layers)), Speck2FConfigBuilder.get_constraints())
    except ValueError:
        assert found.mapping.chips is None
    else:
        assert found.mapping.chips == 1
