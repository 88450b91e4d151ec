"""Readout layers in Loihi's integers: exponent, room, and the choices of quantisation."""

import nir
import numpy as np
import pytest

from spikedeploy.runtime.artifact.artifact import Artifact
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.chips.layer import NEVER
from spikedeploy.runtime.chips.quantisation import Quantisation, Tuning
from spikedeploy.runtime.compiler.compile import compile_program
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.emulator.machine import Machine
from spikedeploy.runtime.errors import RuleError
from spikedeploy.runtime.families.cuba.readouts import NET_EVENTS, exponent_and_share
from spikedeploy.runtime.float_model.graph import FloatGraph
from tests.networks import chain
from tests.readouts import DT, INPUTS, cubali, events, network

LOIHI1 = chip("loihi1").arithmetic


def layer_of(kind, name="loihi1", quantisation=None, limits=True):
    program = compile_program(
        network(kind), chip(name), quantisation or Quantisation(), limits=limits
    )
    return program.layers[-1]


@pytest.mark.parametrize("kind", ["same", "only", "only LI", "only I"])
def test_weights_fill_eight_bits_and_the_exponent_the_registers(kind):
    weights = layer_of(kind).synapses[0].weight.astype(int)
    most = max(np.abs(s.weight.astype(int)).max() for s in layer_of(kind).synapses)
    exponent = int(np.log2(most // 255))
    assert most == 255 << exponent
    assert (weights % (1 << exponent) == 0).all()


@pytest.mark.parametrize("kind", ["only", "only LI", "only I"])
def test_net_spikes_of_the_heaviest_synapse_fill_half_of_a_register_at_most(kind):
    program = compile_program(network(kind), chip("loihi1"))
    weight = program.layers[0].synapses[0].weight.astype(int)
    axon, neuron = np.unravel_index(np.abs(weight).argmax(), weight.shape)
    raster = np.zeros((1, NET_EVENTS, INPUTS), np.uint8)
    raster[..., axon] = 1
    machine = Machine(program, trace=True)
    machine.infer(raster)
    seen = machine.recordings[program.layers[0].name]
    filled = max(np.abs(x[..., neuron]).max() for x in (seen.current, seen.membrane)) / (1 << 23)
    # one exponent more would not leave half; rounded decays lose a little
    assert 0.22 < filled <= 0.5
    assert machine.ledger.total("saturation") == 0


def test_the_family_without_exponents_has_none():
    assert np.abs(layer_of("only", "int").synapses[0].weight).max() == 127


def test_thresholds_of_readouts_are_out_of_reach_and_no_limit():
    layer = layer_of("only")
    assert (layer.threshold == NEVER).all()
    assert not layer.spiking
    few = layer_of("only", quantisation=Quantisation("channel", thresholds=1))
    assert np.ptp(few.scale) > 0


def test_a_scale_that_would_overflow_shrinks():
    # CubaLI with both leaks slow: a spike comes to about 1500 times itself on the membrane
    artifact = network("only")
    node = artifact.graph.nodes["fast"]
    node.tau_mem[:], node.r[:] = node.tau_syn, node.tau_syn / 1e-3
    program = compile_program(artifact, chip("loihi1"))
    assert np.abs(program.layers[0].synapses[0].weight).max() < 255
    floats = compile_program(artifact, chip("ideal")).layers[0]
    exponent, share = exponent_and_share(floats, LOIHI1, 255 / 1.0)
    assert exponent == 0
    assert share < 1


@pytest.mark.parametrize(
    "quantisation",
    [
        Quantisation("channel"),
        Quantisation(rounding="truncate"),
        Quantisation(tuned={"fast": Tuning(clip_ratio=0.5)}),
        Quantisation(tuned={"fast": Tuning(clip_ratio=1.3)}),
    ],
    ids=["channel", "truncate", "room", "clipped"],
)
def test_readouts_take_the_choices_of_quantisation(quantisation):
    artifact = network("only")
    plain = compile_program(artifact, chip("loihi1")).layers[0]
    program = compile_program(artifact, chip("loihi1"), quantisation)
    chosen = program.layers[0]
    assert not np.array_equal(plain.synapses[0].weight, chosen.synapses[0].weight)
    wanted = FloatGraph(artifact).run(events())["output"]
    found = Machine(program, 3).infer(events())
    assert np.abs(found - wanted).max() < 0.25 * np.abs(wanted).max()


def test_all_that_can_arrive_at_once_fits_the_accumulator():
    # a reach of 64 net spikes would allow an exponent of 2; 300 equal weights leave none
    nodes = [nir.Linear(np.ones((1, 300))), cubali(1, membrane=1 / 4096)]
    wide = Artifact(chain(*nodes, width=300, act=1), None, Convention(DT, state="kept"))
    (layer,) = compile_program(wide, chip("loihi1"), limits=False).layers
    assert layer.synapses[0].weight.max() == 255
    narrow = Artifact(
        chain(nir.Linear(np.ones((1, 3))), nodes[1], width=3, act=1), None, wide.convention
    )
    assert compile_program(narrow, chip("loihi1")).layers[0].synapses[0].weight.max() == 255 << 2


def test_a_clip_ratio_leaves_room_and_no_exponent_takes_it_back():
    artifact = network("only")
    half = Quantisation(tuned={"fast": Tuning(clip_ratio=0.5)})
    one, other = (
        compile_program(artifact, chip("loihi1"), each).layers[0] for each in (Quantisation(), half)
    )
    assert other.scale == pytest.approx(2 * one.scale)


def test_proven_headroom_holds_for_readouts_that_leak_fast():
    program = compile_program(network("same"), chip("loihi1"), Quantisation(headroom="proven"))
    machine = Machine(program)
    machine.infer(np.ones((1, 300, INPUTS), np.uint8))
    assert machine.ledger.total("saturation") == 0


@pytest.mark.parametrize("kind", ["only", "only I"])
def test_proven_headroom_refuses_readouts_that_hardly_leak(kind):
    with pytest.raises(RuleError, match=r"rule (headroom|weight-bits): layer 'fast'"):
        compile_program(network(kind), chip("loihi1"), Quantisation(headroom="proven"))
