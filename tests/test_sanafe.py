"""The events that we price, against SANA-FE's simulation of random networks where it is installed.

The extra `sanafe` installs it. Its chip is its own arch/loihi.yaml; the networks, the rasters and
the cores are ours.
"""

import numpy as np
import pytest

from runtime.chip import chip
from runtime.convention import Convention
from runtime.energy import TABLES, energy, latency
from runtime.machine import Machine
from runtime.program import Layer, Program, Synapses
from runtime.traffic import Placement, one_core_each, traffic

CHIP = chip("loihi1")
TABLE = TABLES["sanafe"]
UPDATE = TABLE.joules["neuron_update"] - TABLE.joules["neuron_idle"]
STEPS = 20

# sizes, density, threshold, part of the membrane and of the current kept [/4096], loops, bias
NETWORKS = {
    "dense": ([20, 30, 10], 1.0, 200, 4096, 0, False, 0),
    "sparse": ([20, 30, 10], 0.3, 200, 3000, 0, False, 0),
    "large": ([64, 200, 100, 10], 0.2, 400, 3500, 0, False, 0),
    "recurrent": ([64, 100, 40, 10], 0.2, 300, 3500, 0, True, 0),
    "current": ([20, 30, 10], 0.5, 300, 3072, 2048, False, 0),
    "current-recurrent-biased": ([20, 30, 10], 0.5, 300, 3072, 2048, True, 20),
}


@pytest.fixture(scope="module")
def sanafe():
    return pytest.importorskip("sanafe", reason="the extra `sanafe` is not installed")


def program(case, seed):
    sizes, density, threshold, membrane, current, loops, bias = NETWORKS[case]
    rng = np.random.default_rng(seed)

    def weights(rows, columns, most):
        drawn = rng.integers(-most * 2 // 3, most, (rows, columns))
        return (drawn * (rng.random((rows, columns)) < density)).astype(np.int16)

    names = ["input", *(f"layer{k}" for k in range(1, len(sizes)))]
    layers = []
    for k, size in enumerate(sizes[1:], start=1):
        synapses = [Synapses(names[k - 1], weights(sizes[k - 1], size, 120), delay=1)]
        if loops:
            synapses.append(Synapses(names[k], weights(size, size, 40), delay=1))
        ones = np.ones(size, np.int64)
        layers.append(
            Layer(
                name=names[k],
                synapses=tuple(synapses),
                bias=0 * ones,
                voltage_bias=(bias << 6) * (rng.random(size) < 0.2),
                threshold=(threshold << 6) * ones,
                current_keep=current * ones,
                membrane_keep=membrane * ones,
                scale=1.0,
                start=0,
            )
        )
    return Program(CHIP, Convention(1e-3), "input", sizes[0], tuple(layers), names[-1], None)


def scattered(network, seed, cores=12):
    """Neurons thrown onto twelve cores of three tiles, of which each has four."""
    rng = np.random.default_rng(seed)
    where = {name: rng.integers(0, cores, size) for name, size in network.sizes.items()}
    # their tiles are numbered along columns, of four each
    tiles = np.array([divmod(core // 4, 4) for core in range(cores)])
    return Placement(where, tiles)


def run(network, raster):
    """Our machine after the raster, and the spikes of every neuron."""
    machine = Machine(network, trace=True)
    machine.infer(raster[None])
    seen = {name: rows.spikes[0].sum(axis=0) for name, rows in machine.recordings.items()}
    return machine.ledger, {"input": raster.sum(axis=0), **seen}


def simulated(sanafe, network, raster, placement):
    """What SANA-FE says of the same network on the same cores."""
    architecture, net = sanafe.load_loihi(), sanafe.Network()
    groups = {"input": net.create_neuron_group("input", network.width)}
    for k, neuron in enumerate(groups["input"].neurons):
        spikes = {"spikes": raster[:, k].astype(int).tolist()}
        neuron.set_attributes(soma_hw_name=f"loihi_inputs[{k}]", model_attributes=spikes)
    for layer in network.layers:
        groups[layer.name] = neurons(net, layer)
    for layer in network.layers:
        for synapses in layer.synapses:
            pairs = np.argwhere(synapses.weight)
            weights = {"weight": synapses.weight[tuple(pairs.T)].astype(float).tolist()}
            source, target = groups[synapses.source], groups[layer.name]
            source.connect_neurons_sparse(target, weights, [tuple(p) for p in pairs.tolist()])
    cores = architecture.cores()
    for name, group in groups.items():
        for neuron, core in zip(group.neurons, placement.cores[name].tolist(), strict=True):
            neuron.map_to_core(cores[core])
    simulator = sanafe.SpikingChip(architecture)
    simulator.load(net)
    return simulator.sim(len(raster), perf_trace=True)


def neurons(net, layer):
    """A group of SANA-FE's neurons, in units of weights: 64 of our state units."""
    constants = {
        "threshold": float(layer.threshold[0] / 64),
        "reset_mode": "hard",
        "reset": 0.0,
        "leak_decay": float(layer.membrane_keep[0] / 4096),
        "input_decay": float(layer.current_keep[0] / 4096),
    }
    group = net.create_neuron_group(
        layer.name,
        layer.size,
        soma_hw_name="loihi_lif",
        default_synapse_hw_name="loihi_dense_synapse",
        model_attributes=constants,
    )
    for neuron, bias in zip(group.neurons, (layer.voltage_bias / 64).tolist(), strict=True):
        if bias:
            neuron.set_attributes(model_attributes={"bias": bias})
    return group


@pytest.mark.parametrize("mapping", ["one core each", "scattered"])
@pytest.mark.parametrize("rate", [0.05, 0.3])
@pytest.mark.parametrize("case", NETWORKS)
def test_the_energy_of_a_random_network_is_sanafes(sanafe, case, rate, mapping):
    network = program(case, seed=1)
    raster = (np.random.default_rng(2).random((STEPS, network.width)) < rate).astype(np.uint8)
    placement = one_core_each(network) if mapping == "one core each" else scattered(network, 3)
    ledger, spikes = run(network, raster)
    sent = traffic(network, spikes, placement)
    theirs = simulated(sanafe, network, raster, placement)
    inputs = int(raster.sum())
    assert ledger.total("sop") == theirs["spikes"] > 0
    assert ledger.total("spike_out") == theirs["neurons_fired"] - inputs
    assert sent.message == theirs["packets_sent"]
    assert sent.hop_x + sent.hop_y == sum(theirs["perf_trace"]["hops"])
    # neurons that hear weights which cancel are busy there, and those with a current left are here
    more = ledger.total("neuron_update") - (theirs["neurons_updated"] - inputs)
    assert abs(more) <= 0.01 * ledger.total("neuron_update")
    ours = energy(ledger, TABLE, sent)
    assert ours - more * UPDATE == pytest.approx(theirs["energy"]["total"], rel=1e-9)
    assert ours == pytest.approx(theirs["energy"]["total"], rel=2e-3)


@pytest.mark.parametrize("case", NETWORKS)
def test_energies_are_sanafes_without_a_placement_too_where_nothing_goes_to_a_host(sanafe, case):
    network = program(case, seed=4)
    raster = (np.random.default_rng(5).random((STEPS, network.width)) < 0.2).astype(np.uint8)
    ledger, _ = run(network, raster)
    theirs = simulated(sanafe, network, raster, one_core_each(network))
    to_host = ledger.by_layer("spike_out")[network.output] * TABLE.joules["message"]
    assert energy(ledger, TABLE) - to_host == pytest.approx(theirs["energy"]["total"], rel=0.05)


@pytest.mark.parametrize("case", NETWORKS)
def test_the_time_of_layers_on_one_tile_is_an_upper_bound_of_sanafes(sanafe, case):
    network = program(case, seed=6)
    raster = (np.random.default_rng(7).random((STEPS, network.width)) < 0.2).astype(np.uint8)
    ledger, _ = run(network, raster)
    theirs = simulated(sanafe, network, raster, one_core_each(network))
    assert 1.0 < latency(ledger, TABLE) / theirs["sim_time"] < 4.0
