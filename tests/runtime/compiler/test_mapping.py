"""Networks on cores, with numbers worked by hand."""

from dataclasses import replace
from itertools import pairwise

import nir
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spikedeploy.runtime.artifact.artifact import Artifact
from spikedeploy.runtime.chips.chip import SynapticMemory, chip
from spikedeploy.runtime.compiler.lowering import lower
from spikedeploy.runtime.compiler.mapping import (
    Entries,
    Loads,
    entries,
    list_bits,
    map_to_cores,
    mapping_utilisation,
    placement_utilisation,
)
from spikedeploy.runtime.compiler.rules import evaluate, place
from spikedeploy.runtime.convention import Convention
from tests.networks import chain, cuba, ends, graph, lif

MIXED = chip("loihi1", sign_mode="mixed")
SPLIT = chip("loihi1")
WORDS = SynapticMemory(size=1 << 20, cost="words", weight_bits=8)


def lowered(network):
    return lower(Artifact(network, None, Convention(1e-3))).on_chip(membranes=True)


def placed(network, on):
    return map_to_cores(lowered(network), on)


def dense(*sizes, weight=None, bias=0.1):
    """Layers of LIF neurons whose every weight is there."""
    nodes = []
    for fan_in, size in pairwise(sizes):
        found = np.ones((size, fan_in)) if weight is None else weight(size, fan_in)
        nodes += [nir.Affine(found, np.full(size, float(bias))), cuba(size)]
    return chain(*nodes, width=sizes[0], act=sizes[-1])


def alternating(size, fan_in):
    """Half of the weights of each axon excite, half inhibit, in turn."""
    return np.where(np.arange(size) % 2, 1.0, -1.0)[:, None] * np.ones((1, fan_in))


def test_a_list_is_stored_in_the_way_that_takes_less():
    # one synapse of 100 neurons: 8 + 7 + 10 = 25 bits, a word; dense it would take 576 + 320
    assert list_bits(np.array([[1], [1]]), 100, WORDS, delayed=False).tolist() == [128]
    # all 64: dense 522 bits, nine words; with indices of 6 bits 906, fifteen
    assert list_bits(np.array([[64]]), 64, WORDS, delayed=False).tolist() == [576]
    # a delay is 6 bits more: 64 x 14 + 10 = 906
    assert list_bits(np.array([[64]]), 64, WORDS, delayed=True).tolist() == [960]


def test_popsan_takes_ten_cores_of_loihi_as_one_list():
    found = placed(dense(770, 512, 512, 180), MIXED)
    assert {p.name: p.cores for p in found.placements} == {
        "input": 1,
        "n2": 4,
        "n4": 3,
        "n6": 1,
        "bias": 1,
    }
    assert (found.cores, found.chips) == (10, 1)
    # 771 axons of 128 neurons, 513 of 171 and of 180: 108, 96 and 100 KB
    memory = {p.name: p.memory // 8 for p in found.placements if p.kind == "neurons"}
    assert memory == {"n2": 771 * 144, "n4": 513 * 192, "n6": 513 * 200}


def test_popsan_takes_more_cores_with_a_list_for_each_sign():
    found = placed(dense(770, 512, 512, 180, weight=alternating), SPLIT)
    cores = {p.name: p.cores for p in found.placements}
    assert (cores["n2"], cores["n4"], cores["n6"]) == (7, 5, 2)
    # an axon to each of 7 cores: 4096 // 7 = 585 encoders in a core
    assert cores["input"] == 2


@pytest.mark.parametrize(("size", "cores"), [(1024, 1), (1025, 2), (2048, 2), (2049, 3)])
def test_neurons_of_a_core_divide_a_layer(size, cores):
    assert placed(dense(1, size), MIXED).placements[1].cores == cores


@settings(max_examples=16)
@given(st.integers(1, 300), st.integers(1, 400), st.integers(1, 100), st.booleans())
def test_a_division_fits_and_none_into_fewer_cores_does(size, fan_in, room, full):
    signs = [1.0] if full else [-1.0, 0.0, 1.0]
    weight = np.random.default_rng(room).choice(signs, (size, fan_in))
    network = chain(nir.Affine(weight, np.ones(size)), cuba(size), width=fan_in, act=size)
    memory = SynapticMemory(size=64 * fan_in * 2 + 64 * room, cost="words", weight_bits=8)
    limits = replace(SPLIT.limits, memory=memory, neurons_per_core=100)
    (population,) = lowered(network).populations
    placement = map_to_cores(lowered(network), replace(SPLIT, limits=limits)).placements[1]
    assert (placement.cores - 1) * placement.block < size <= placement.cores * placement.block
    fits = [
        block
        for block in range(1, min(size, 100) + 1)
        if Loads(population, limits, 2).find_fullest(block).memory <= memory.size
    ]
    if fits:
        assert placement.block in fits
        # blocks of other sizes have other borders, so that one beyond may fit by chance
        assert placement.cores <= -(-size // fits[0])
        if full:
            assert placement.cores == -(-size // fits[-1])
    else:
        assert placement.block == 1


def test_axons_out_of_a_core_divide_the_layer_that_is_heard():
    # 8 neurons presynaptic to 4 cores are 32 axons; 16 a core leave room for 4 neurons
    limits = replace(MIXED.limits, neurons_per_core=8, axons_out=16, input_cores=False)
    found = placed(dense(2, 8, 32), replace(MIXED, limits=limits)).placements
    assert [(p.cores, p.block, p.axons_out) for p in found] == [(2, 4, 16), (4, 8, 0)]


def test_a_spike_needs_no_more_axons_than_it_has_synapses():
    # each of 8 neurons has one synapse, in however many cores the others lie
    limits = replace(MIXED.limits, neurons_per_core=8, axons_out=8, input_cores=False)
    nodes = nir.Linear(np.ones((8, 2))), cuba(8), nir.Linear(np.eye(8)), cuba(8)
    network = chain(*nodes, width=2, act=8)
    one_each = replace(limits, neurons_per_core=1)
    for held, axons in ((limits, [8, 0]), (one_each, [1, 0])):
        found = placed(network, replace(MIXED, limits=held)).placements
        assert [placement.axons_out for placement in found] == axons


def test_a_convolution_has_less_synapses_at_its_edges():
    weight = np.ones((3, 2, 3, 3))
    node = nir.Conv2d((4, 4), weight, 1, 1, 1, 1, np.zeros(3))
    neurons = nir.IF(*(np.full((3, 4, 4), v) for v in (1.0, 1.0)))
    network = graph("input->c, c->n, n->output", c=node, n=neurons, **ends([2, 4, 4], [3, 4, 4]))
    (population,) = lowered(network).populations
    into, out = population.presynaptic[0].into, population.presynaptic[0].out
    # corners see 2 x 2 pixels, edges 2 x 3, the middle 3 x 3, of 2 channels; each for 3 features
    assert into.reshape(3, 4, 4)[0, 0].tolist() == [8, 12, 12, 8]
    assert into.reshape(3, 4, 4)[2, 1].tolist() == [12, 18, 18, 12]
    assert out.reshape(2, 4, 4)[1, 0].tolist() == [12, 18, 18, 12]
    assert into.sum() == out.sum()


def test_the_host_computes_what_no_neuron_follows():
    nodes = nir.Linear(np.ones((4, 3))), lif(4), nir.Linear(np.ones((2, 4))), nir.Scale(np.ones(2))
    network = chain(*nodes, width=3, act=2)
    found = lowered(network)
    assert found.host == ("n3", "n4")
    assert [p.leaves for p in found.populations] == [True]


def test_utilisation_is_what_is_taken_of_what_there_is():
    found = placed(dense(770, 512, 512, 180), MIXED)
    layer = next(p for p in found.placements if p.name == "n4")
    shares = placement_utilisation(layer, MIXED.limits)
    assert shares["neurons"] == 171 / 1024
    assert shares["memory"] == 513 * 192 / (128 * 1024)
    assert shares["axons_in"] == 513 / 4096
    # 770 encoders, 1204 neurons and the bias in ten cores
    assert mapping_utilisation(found.placements, MIXED.limits)["neurons"] == pytest.approx(
        1975 / 10240
    )


def test_a_linear_map_behind_a_flatten_is_a_kernel():
    # 3 channels of 5 x 5: 25 taps take 32, 10 features 16
    nodes = {
        "input": nir.Input(np.array([3, 5, 5])),
        "f": nir.Flatten({"input": np.array([3, 5, 5])}, 0, -1),
        "w": nir.Linear(np.ones((10, 75))),
        "n": nir.IF(*(np.full(10, v) for v in (1.0, 1.0))),
        "output": nir.Output(np.array([10])),
    }
    network = graph("input->f, f->w, w->n, n->output", **nodes)
    assert entries(network, lowered(network).populations[0]) == Entries(3 * 32 * 16, 10)


def neuromorphic_mnist():
    """A network for N-MNIST of three convolutions, two pools and two maps, without a leak."""

    def convolution(features, channels, size, kernel, stride):
        weight = np.ones((features, channels, kernel, kernel))
        return nir.Conv2d((size, size), weight, stride, 1, 1, 1, np.zeros(features))

    def integrate(*shape):
        return nir.IF(*(np.full(shape, v) for v in (1000.0, 1.0)))

    two = np.array([2, 2])
    nodes = {
        "input": nir.Input(np.array([2, 34, 34])),
        "c1": convolution(16, 2, 34, 5, 2),
        "n1": integrate(16, 16, 16),
        "c2": convolution(16, 16, 16, 3, 1),
        "n2": integrate(16, 16, 16),
        "p2": nir.SumPool2d(two, two, np.array([0, 0])),
        "c3": convolution(8, 16, 8, 3, 1),
        "n3": integrate(8, 8, 8),
        "p3": nir.SumPool2d(two, two, np.array([0, 0])),
        "f": nir.Flatten({"input": np.array([8, 4, 4])}, 0, -1),
        "w4": nir.Linear(np.ones((256, 128))),
        "n4": integrate(256),
        "w5": nir.Linear(np.ones((10, 256))),
        "n5": integrate(10),
        "output": nir.Output(np.array([10])),
    }
    return nir.NIRGraph(nodes, list(pairwise(nodes)), type_check=False)


def test_a_convolutional_network_finds_a_core_of_speck_for_each_layer():
    found = placed(neuromorphic_mnist(), chip("speck2f"))
    # kernels: 2 x 32 x 16, 16 x 16 x 16, 16 x 16 x 8, 8 x 16 x 256 (a kernel of 4 x 4), 256 x 16
    assert [p.memory for p in found.placements] == [1024, 4096, 2048, 32768, 4096]
    assert [p.block for p in found.placements] == [4096, 4096, 512, 256, 10]
    # only cores 3 to 6 have 32 Ki entries of kernel memory
    assert [p.first for p in found.placements] == [0, 1, 2, 3, 4]


def test_a_convolutional_network_keeps_every_rule_of_speck():
    artifact = Artifact(neuromorphic_mnist(), None, Convention(1e-3, reset="subtract"))
    on = chip("speck2f")
    assert [r for r in evaluate(place(artifact, on)) if r.failed] == []
