"""Copies of what is running go on exactly as the original does, and threads wait for their turn."""

import copy
import multiprocessing
import pickle
import sys
import warnings
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from importlib.util import find_spec

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.codec.rate import RateEncoder
from spikedeploy.runtime.compiler.compile import compile_program
from spikedeploy.runtime.emulator.controllers import SpikingController
from spikedeploy.runtime.emulator.float_machine import FloatMachine
from spikedeploy.runtime.emulator.machine import Machine
from spikedeploy.runtime.emulator.network import MachinePool
from tests.equality import runs
from tests.networks import event_driven, popsan, spiking_mlp
from tests.programs import random_programs, rasters

BACKENDS = ["interpreter", "numpy", *(["numba"] if find_spec("numba") else [])]
COPIES = {"deepcopy": copy.deepcopy, "pickle": lambda it: pickle.loads(pickle.dumps(it))}
copied = pytest.mark.parametrize("copied", COPIES.values(), ids=COPIES)


def check_same(one, other):
    """Two machines hold the same states, recordings and counts."""
    for name in one.membrane:
        np.testing.assert_array_equal(one.membrane[name], other.membrane[name])
        np.testing.assert_array_equal(one.current[name], other.current[name])
    assert one.recordings.keys() == other.recordings.keys()
    for name, found in one.recordings.items():
        for quantity, values in vars(found).items():
            np.testing.assert_array_equal(values, getattr(other.recordings[name], quantity))
    check_same_ledger(one.ledger, other.ledger)


def check_same_ledger(one, other):
    np.testing.assert_array_equal(one.counts, other.counts)
    assert (one.inferences, one.timesteps, one.steps) == (
        other.inferences, other.timesteps, other.steps,
    )  # fmt: skip


def runnable(program, backend):
    """The program with registers that the backend knows."""
    if backend != "numba":
        return program
    fixed = program.chip.arithmetic
    plain = replace(
        fixed,
        push=replace(fixed.push, overflow="none"),
        membrane=replace(fixed.membrane, overflow="clip", between=None),
    )
    return replace(program, chip=replace(program.chip, arithmetic=plain))


@copied
@pytest.mark.parametrize("backend", BACKENDS)
@settings(max_examples=25, deadline=None)
@given(program=random_programs(), run=runs, used=st.sampled_from([0, 1, 2]))
def test_a_copy_of_a_used_machine_infers_on_as_the_original(backend, copied, program, run, used):
    machine = Machine(runnable(program, backend), run[0], trace=True, backend=backend)
    all_ = rasters(program, *run, inferences=4)
    for raster in all_[:used]:
        machine.infer(raster)
    other = copied(machine)
    check_same(machine, other)
    for raster in all_[used:]:
        np.testing.assert_array_equal(machine.infer(raster), other.infer(raster))
        check_same(machine, other)


@copied
@pytest.mark.parametrize("backend", BACKENDS)
@settings(max_examples=25, deadline=None)
@given(program=random_programs(), run=runs, used=st.sampled_from([0, 1, 3]))
def test_a_copy_of_a_machine_that_streams_goes_on_as_the_original(
    backend, copied, program, run, used
):
    machine = Machine(runnable(program, backend), run[0], backend=backend)
    raster = rasters(program, run[0], 7, *run[2:])[0].swapaxes(0, 1)
    for row in raster[:used]:
        machine.step(row)
    other = copied(machine)
    for row in raster[used:]:
        np.testing.assert_array_equal(machine.step(row), other.step(row))
        check_same(machine, other)


@copied
@pytest.mark.parametrize("backend", BACKENDS)
def test_what_a_copy_does_leaves_the_original_alone(backend, copied):
    artifact = popsan()
    kept = replace(artifact, convention=replace(artifact.convention, state="kept", delay=1))
    program = compile_program(kept, chip("loihi1"))
    first, second, third = rasters(program, 2, 5, 0.4, seed=0, inferences=3)
    machine, alone = (Machine(program, 2, backend=backend) for _ in range(2))
    machine.infer(first)
    copied(machine).infer(second)
    alone.infer(first)
    np.testing.assert_array_equal(machine.infer(third), alone.infer(third))
    check_same(machine, alone)


def kept(artifact):
    return replace(artifact, convention=replace(artifact.convention, state="kept", delay=1))


def random(artifact):
    low, high = artifact.codec.encoder.low, artifact.codec.encoder.high
    code = replace(artifact.codec, encoder=RateEncoder(low, high, "bernoulli"))
    return replace(artifact, codec=code)


POLICIES = {
    "population": (popsan, {}),
    "kept": (lambda: kept(popsan()), {}),
    "sampled": (spiking_mlp, {"sampled": True}),
    "random": (lambda: kept(random(spiking_mlp())), {}),
    "delta": (event_driven, {}),
}
CHIPS = [(None, "numpy"), ("ideal", "numpy"), *(("loihi1", backend) for backend in BACKENDS)]


@copied
@pytest.mark.parametrize("kind", POLICIES)
@pytest.mark.parametrize(("name", "backend"), CHIPS)
def test_a_copy_of_a_used_controller_acts_on_as_the_original(copied, kind, name, backend):
    make, options = POLICIES[kind]
    artifact = make()
    controller = SpikingController(artifact, name and chip(name), backend=backend, **options)
    controller.reset(3)
    seen = np.random.default_rng(1).uniform(-1, 1, (20, 2, artifact.codec.encoder.observed))
    for observations in seen[:7]:
        controller.act_batch(observations)
    other = copied(controller)
    for observations in seen[7:]:
        expected = controller.act_batch(observations)
        np.testing.assert_array_equal(other.act_batch(observations), expected)
    check_same_ledger(other.ledger, controller.ledger)


@copied
@pytest.mark.parametrize("make", [FloatMachine, MachinePool])
def test_a_copy_of_what_runs_batches_goes_on_in_every_batch(copied, make):
    artifact = popsan()
    of = artifact if make is FloatMachine else compile_program(artifact, chip("loihi1"))
    machine = make(of)
    program = machine.program
    first, second = (rasters(program, batch, 5, 0.3, seed=batch)[0] for batch in (1, 70))
    machine.infer(first)
    machine.infer(second)
    other = copied(machine)
    for raster in (second, first):
        np.testing.assert_array_equal(other.infer(raster), machine.infer(raster))
    check_same_ledger(other.ledger, machine.ledger)


@pytest.mark.parametrize(("name", "backend"), CHIPS)
def test_threads_on_one_machine_get_what_one_thread_gets(name, backend):
    artifact = popsan(hidden=(210, 30))

    def make():
        return SpikingController(artifact, name and chip(name), "total", backend=backend)

    alone, shared = make(), make()
    program = alone.program
    spikes = rasters(program, 1, 5, 0.2, seed=0, inferences=30)
    expected = [alone.network.infer(raster) for raster in spikes]
    with ThreadPoolExecutor(3) as pool:
        found = list(pool.map(lambda k: shared.network.infer(spikes[k % 30]), range(300)))
    for k, output in enumerate(found):
        np.testing.assert_array_equal(output, expected[k % 30])
    np.testing.assert_array_equal(shared.ledger.counts, 10 * alone.ledger.counts)


@copied
@pytest.mark.parametrize("make", [FloatMachine, MachinePool])
def test_a_copy_made_while_threads_run_holds_whole_inferences(copied, make):
    artifact = popsan()
    of = artifact if make is FloatMachine else compile_program(artifact, chip("loihi1"))
    machine = make(of)
    spikes = rasters(machine.program, 1, 5, 0.3, seed=0)[0]
    machine.infer(spikes)
    one = machine.ledger.counts.sum(axis=0)

    def work(size):
        for _ in range(40):
            machine.infer(np.repeat(spikes, size, axis=0))

    with ThreadPoolExecutor(3) as pool:
        done = [pool.submit(work, size) for size in (1, 2, 5)]
        while not all(each.done() for each in done):
            other = copied(machine)
            ledger = other.ledger
            np.testing.assert_array_equal(ledger.counts.sum(axis=0), ledger.inferences * one)
    assert machine.ledger.inferences == 1 + 40 * (1 + 2 + 5)


@pytest.mark.skipif(sys.platform == "win32", reason="processes are spawned there")
def test_machines_of_one_program_in_threads_and_after_a_fork_are_alike():
    program = compile_program(popsan(), chip("loihi1"))
    spikes = rasters(program, 1, 5, 0.3, seed=0)[0]

    def output(_=None):
        return Machine(program).infer(spikes)

    expected = output()
    with ThreadPoolExecutor(4) as pool:
        for found in pool.map(output, range(40)):
            np.testing.assert_array_equal(found, expected)
    ours, theirs = multiprocessing.Pipe()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # Python's, that threads are running
        process = multiprocessing.get_context("fork").Process(target=lambda: theirs.send(output()))
        process.start()
    assert ours.poll(60)
    np.testing.assert_array_equal(ours.recv(), expected)
    process.join()
