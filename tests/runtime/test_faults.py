"""Faults of chips: what they hit, and that nothing else changes."""

import nir
import numpy as np
import pytest

from spikedeploy.runtime.artifact.artifact import Artifact
from spikedeploy.runtime.chips.chip import CHIPS, chip
from spikedeploy.runtime.chips.damage import keys, uniform
from spikedeploy.runtime.compiler.compile import compile_program
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.emulator.backend import backend_class
from spikedeploy.runtime.emulator.controllers import SpikingController
from spikedeploy.runtime.emulator.interpreter import InterpreterBackend
from spikedeploy.runtime.emulator.machine import Machine
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.faults import FAULTS, faults, inject
from tests import graded
from tests.networks import chain, event_driven, lif, popsan

FLOATS = ("ideal", "spinnaker2", "spinnaker2-lif")
INTEGERS = [name for name in CHIPS if name not in FLOATS]
OVER_TIME = [name for name in FAULTS if FAULTS[name].damage_layers is None]
OF_WEIGHTS = ("stuck-zero", "stuck-max", "weight-flips")


def program_on(name, seed=0):
    """A network of two layers that every chip of integers takes."""
    rng = np.random.default_rng(seed)
    xylo = name.startswith("xylo")

    def neurons(size):
        if xylo:
            return lif(size, tau=2e-3, r=2.0)
        ones = np.ones(size)
        return nir.IF(r=1000 * ones, v_threshold=ones, v_reset=0 * ones)

    nodes = [
        nir.Linear(rng.normal(size=(40, 8))),
        neurons(40),
        nir.Linear(rng.normal(size=(6, 40))),
        neurons(6),
    ]
    convention = Convention(1e-3, reset="subtract" if xylo else "zero")
    artifact = Artifact(chain(*nodes, width=8, act=6), None, convention)
    return compile_program(artifact, chip(name), limits=False)


def spikes(batch=3, timesteps=30, width=8, seed=1):
    rng = np.random.default_rng(seed)
    return (rng.random((batch, timesteps, width)) < 0.3).astype(np.uint8)


@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_has_three_rising_levels_within_its_bounds(name):
    found = FAULTS[name]
    lowest, highest = found.bounds
    assert lowest < found.levels[0] < found.levels[1] < found.levels[2] <= highest
    assert found.meaning
    assert found.unit
    assert found.source
    assert found.what


@pytest.mark.parametrize("name", INTEGERS)
@pytest.mark.parametrize("kind", FAULTS)
def test_every_chip_of_integers_runs_every_fault_and_counts_it(name, kind):
    program = program_on(name)
    if kind in OF_WEIGHTS and not program.chip.arithmetic.own_weights:
        with pytest.raises(ConfigError, match="one weight for all axons of a type"):
            inject(program, faults([f"{kind}:3"]))
        return
    number = 0.2  # of anything, so that small networks are hit
    pool = Machine(inject(program, faults([f"{kind}={number}"])), None)
    whole = Machine(program, None).infer(spikes())
    assert not np.array_equal(pool.infer(spikes()), whole)
    (damage,) = pool.damage
    assert 0 < damage.hit <= damage.of
    assert (damage.name, damage.number, damage.over_time) == (kind, number, kind in OVER_TIME)


@pytest.mark.parametrize("name", FLOATS)
def test_chips_that_compute_in_floats_have_no_faults(name):
    with pytest.raises(ConfigError, match=f"chip '{name}' computes in floats"):
        inject(program_on(name), faults(["dead-neurons:1"]))


# broken parts


@pytest.mark.parametrize("name", INTEGERS)
def test_dead_neurons_are_as_many_as_asked_for_and_never_spike(name):
    program = inject(program_on(name), faults(["dead-neurons=0.5"]))
    (damage,) = program.damage
    assert (damage.hit, damage.of) == (23, 46)
    machine = Machine(program, 3, trace=True)
    machine.infer(np.ones((3, 30, 8), np.uint8))
    silent = sum(
        int((~each.spikes.astype(bool).any(axis=(0, 1))).sum())
        for each in machine.recordings.values()
    )
    assert silent >= 23
    dead = sum(int((~s.weight.any(axis=0)).sum()) for a in program.layers for s in a.synapses)
    assert dead >= 23


@pytest.mark.parametrize("name", ["loihi1", "speck2f"])
def test_dead_neurons_that_share_a_kernel_never_spike_and_leave_it_whole(name):
    shape, zero = (4, 6, 6), np.zeros((4, 6, 6))
    kernel = nir.Conv2d((6, 6), np.ones((4, 1, 3, 3)), 1, 1, 1, 1, np.zeros(4))
    neurons = nir.IF(1000 + zero, 1 + zero, zero)
    convention = Convention(1e-3, reset=chip(name).resets[0])
    network = chain(kernel, neurons, width=(1, 6, 6), act=shape)
    program = compile_program(Artifact(network, None, convention), chip(name))
    broken = inject(program, faults(["dead-neurons=0.5", "threshold-mismatch:3"]))
    np.testing.assert_array_equal(
        broken.layers[0].synapses[0].weight, program.layers[0].synapses[0].weight
    )
    counts = []
    for each in (program, broken):
        machine = Machine(each, 1, "none", trace=True)
        machine.infer(np.ones((1, 9, 36), np.uint8))
        counts.append((machine.spikes["n2"] > 0).any(axis=(0, 1)).sum())
    assert counts == [144, 72]
    hit = inject(program, faults(["stuck-zero=0.5"]))
    assert np.count_nonzero(hit.layers[0].synapses[0].weight) == 18
    assert hit.damage[0].of == 36


def test_readouts_are_spared_by_dead_neurons_and_mismatch():
    program = compile_program(graded.delta_network(), chip("loihi2"))
    broken = inject(program, faults(["dead-neurons=1", "threshold-mismatch=0.3"]))
    before, after = program.layer("readout"), broken.layer("readout")
    assert np.array_equal(before.threshold, after.threshold)
    assert np.array_equal(before.synapses[0].weight, after.synapses[0].weight)


@pytest.mark.parametrize("name", [n for n in INTEGERS if n != "truenorth"])
def test_only_stored_weights_are_hit_and_stay_in_their_range(name):
    program = program_on(name)
    (first, *_) = program.layers
    weight = first.synapses[0].weight.copy()
    weight[:3] = 0
    arithmetic = program.chip.arithmetic
    largest = 1 << (arithmetic.weight_bits - arithmetic.weights_have_signs)
    step = int(np.gcd.reduce(weight[weight != 0].astype(int)))
    for kind in OF_WEIGHTS:
        broken = inject(program, faults([f"{kind}=0.5"]))
        for before, after in zip(program.layers, broken.layers, strict=True):
            old, new = before.synapses[0].weight, after.synapses[0].weight
            assert new.dtype == old.dtype
            assert not new[old == 0].any()
            assert np.abs(new.astype(int)).max() <= largest * max(step, 2)


@pytest.mark.parametrize(("sign_mode", "signed"), [("split", False), ("mixed", True)])
def test_a_flipped_weight_differs_in_one_bit_of_what_the_chip_stores(sign_mode, signed):
    artifact = popsan()
    program = compile_program(artifact, chip("loihi1", sign_mode=sign_mode))
    broken = inject(program, faults(["weight-flips=0.5"]))
    step = program.chip.arithmetic.weight_step
    for before, after in zip(program.layers, broken.layers, strict=True):
        old = before.synapses[0].weight.astype(int) // step
        new = after.synapses[0].weight.astype(int) // step
        stored = (old & 255) ^ (new & 255) if signed else np.abs(old) ^ np.abs(new)
        flipped = stored[stored != 0]
        assert flipped.size
        assert (flipped & (flipped - 1) == 0).all()
        if not signed:
            assert (np.sign(old) * np.sign(new) >= 0).all()


# upsets


def test_upsets_happen_as_often_as_their_probability_and_on_the_interpreter_alone():
    lost = inject(program_on("loihi1"), faults(["lost-spikes=1"]))
    pool = Machine(lost, None, trace=True)
    pool.infer(spikes())
    assert pool.damage[0].hit == pool.damage[0].of == spikes().sum()
    assert not any(rows.any() for rows in pool.spikes.values())
    spurious = inject(program_on("loihi1"), faults(["spurious-spikes=0.1"]))
    pool = Machine(spurious, None)
    pool.infer(np.zeros((20, 50, 8), np.uint8))
    assert pool.damage[0].hit / pool.damage[0].of == pytest.approx(0.1, rel=0.05)
    assert backend_class(lost, "numpy") is InterpreterBackend
    with pytest.raises(ConfigError, match="drawn by the interpreter alone"):
        backend_class(lost, "numba")


def test_flipped_states_stay_in_the_register_of_the_membrane():
    pool = Machine(inject(program_on("int"), faults(["state-flips=0.3"])), None, trace=True)
    pool.infer(spikes())
    limit = 1 << (program_on("int").chip.arithmetic.membrane.bits - 1)
    seen = [np.abs(each.membrane).max() for each in pool.recordings.values()]
    assert max(seen) <= limit
    assert pool.damage[0].hit > 0


@pytest.mark.parametrize("artifact", [popsan, event_driven])
def test_a_robot_of_a_batch_has_the_upsets_that_it_has_alone(artifact):
    broken = faults([f"{name}=0.05" for name in OVER_TIME])
    rows = np.random.default_rng(0).normal(size=(12, 4, 3))
    together = SpikingController(artifact(), chip("loihi1"), faults=broken)
    together.reset(0, each=[7, 8, 9, 10])
    batch = np.stack([together.act_batch(row) for row in rows], 1)
    for place, seed in enumerate([7, 8, 9, 10]):
        alone = SpikingController(artifact(), chip("loihi1"), faults=broken)
        alone.reset(seed)
        # readouts are added up in another order
        np.testing.assert_allclose([alone.act(row[place]) for row in rows], batch[place], 1e-12)


def test_draws_are_uniform_and_differ_by_place_and_seed():
    draws = uniform(keys(0, range(200)), (1, 2, 3), 500)
    assert draws.min() >= 0
    assert draws.max() < 1
    assert draws.mean() == pytest.approx(0.5, abs=0.01)
    assert len(np.unique(draws)) == draws.size
    assert np.corrcoef(draws[0], draws[1])[0, 1] == pytest.approx(0, abs=0.2)
    assert not np.isin(uniform(keys(0, range(200)), (1, 2, 4), 500), draws).any()
    assert not np.isin(uniform(keys(1, range(200)), (1, 2, 3), 500), draws).any()


@pytest.mark.parametrize(
    ("texts", "said"),
    [
        (["burnt:1"], "a chip has no 'burnt'; it has dead-neurons"),
        (["dead-neurons"], "takes name:level or name=number"),
        (["dead-neurons:7"], "no level from 0 to 3; a number is written dead-neurons=7"),
        (["dead-neurons=7"], "'7' is not a number from 0 to 1"),
        (["dead-neurons=all"], "is not a number"),
        (["lost-spikes:1", "lost-spikes=0.2"], "--fault lost-spikes is given twice"),
    ],
)
def test_a_request_that_cannot_be_met_says_what_can(texts, said):
    with pytest.raises(ConfigError, match=said):
        faults(texts)
