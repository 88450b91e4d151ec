"""Copies of what runs: they act as the original from where it was copied, or are refused."""

import contextlib
import copy
import pickle
from dataclasses import replace

import nir
import numpy as np
import pytest

from spikedeploy.runtime.artifact.artifact import Artifact
from spikedeploy.runtime.chips.chip import CHIPS, chip
from spikedeploy.runtime.codec.codec import Codec, Normaliser, RateEncoder
from spikedeploy.runtime.compiler.compile import compile_program
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.emulator.backend import backend_class
from spikedeploy.runtime.emulator.controllers import SpikingController
from spikedeploy.runtime.emulator.machine import Machine
from spikedeploy.runtime.emulator.running_network import FloatMachine
from spikedeploy.runtime.errors import ConfigError, RuleError
from spikedeploy.runtime.families.integrate_and_fire.event_machine import EventMachine
from spikedeploy.runtime.faults import faults, inject
from tests.graded import delta_network
from tests.networks import chain, cuba, event_driven, lif, popsan, spiking_mlp

WAYS = {
    "copy": copy.copy,
    "deepcopy": copy.deepcopy,
    "pickle": lambda each: pickle.loads(pickle.dumps(each)),
}
BACKENDS = ("interpreter", "numpy", "numba")
OBSERVED, ACTIONS, STEPS = 8, 4, 4


def neurons(kind, size):
    if kind == "integrators":
        return nir.IF(np.full(size, 1000.0), np.full(size, 2.0), np.zeros(size))
    if kind == "leaky":
        return lif(size, tau=0.008, r=8.0, threshold=2.0)
    return cuba(size, alpha=0.5, beta=0.75, threshold=1.0)


def policy(kind, reset, state="kept", delay=0):
    """A policy whose encoder draws, with weights that every chip has, and excitatory enough."""
    rng = np.random.default_rng(5)
    first, second = (rng.choice([0.0, 1.0], size) for size in ((6, OBSERVED), (ACTIONS, 6)))
    nodes = [nir.Linear(first), neurons(kind, 6), nir.Linear(second), neurons(kind, ACTIONS)]
    encoder = RateEncoder(np.full(OBSERVED, -3.0), np.full(OBSERVED, 1.0), "bernoulli")
    identity = Normaliser(np.zeros(OBSERVED), np.ones(OBSERVED), 5.0)
    convention = Convention(1e-3, reset, delay=delay).with_options({"state": state})
    graph = chain(*nodes, width=OBSERVED, act=ACTIONS)
    return Artifact(graph, Codec(identity, encoder, 5, "tanh"), convention)


def runnable(name, **options):
    """A policy that the chip runs, of neurons that have as many states as it allows."""
    for kind in ("synaptic", "leaky", "integrators"):
        for reset in ("zero", "subtract"):
            try:
                compile_program(found := policy(kind, reset, **options), chip(name))
            except RuleError:
                continue
            return found
    raise AssertionError(name)


def rows(batch=1, count=STEPS + 4, observed=OBSERVED, seed=0):
    return np.random.default_rng(seed).normal(size=(count, batch, observed))


def spikes(batch, *more, seed=0):
    return np.random.default_rng(seed).integers(0, 2, (batch, *more), np.uint8)


def check_copies(made, act, inputs, used=4):
    """What is made acts on `used` inputs, is copied, and then all copies act as a fresh one does.

    Each on its own: copies first, so that what they share with the original would show.
    """
    whole = made()
    wanted = [act(whole, each) for each in inputs]
    original = made()
    for each in inputs[:used]:
        act(original, each)
    copies = {name: way(original) for name, way in WAYS.items()}
    copies |= {"of a copy": copy.copy(copies["deepcopy"]), "original": original}
    for name, each in copies.items():
        for given, found in zip(inputs[used:], wanted[used:], strict=True):
            for ours, theirs in zip(act(each, given), found, strict=True):
                np.testing.assert_array_equal(ours, theirs, err_msg=name)
        np.testing.assert_array_equal(each.ledger.counts, whole.ledger.counts, err_msg=name)
        assert each.ledger.steps == whole.ledger.steps
    return whole


def act(controller, observations):
    return controller.act_batch(observations), controller.encoded, controller.output


def infer(machine, raster):
    found = machine.infer(raster)
    seen = [each for name in machine.recordings for each in vars(machine.recordings[name]).values()]
    return found, *(each for each in seen if each is not None)


def step(machine, row):
    output = machine.step(row)
    states = [*machine.current.values(), *machine.membrane.values()]
    sent = [machine.sent(layer.name) for layer in machine.program.layers]
    # memory of the machine until the next step
    return [each.copy() for each in (output, *states, *sent)]


def backends(program):
    """A name of each that runs a program."""
    found = {}
    for name in BACKENDS:
        with contextlib.suppress(ConfigError):
            found.setdefault(backend_class(program, name), name)
    return found.values()


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("name", [*CHIPS, "speck2f:queue=on", "odin:queue=on"])
def test_copies_of_a_used_controller_act_as_it_does_on_every_chip_and_backend(name, backend):
    artifact = runnable(name)
    if backend not in backends(compile_program(artifact, chip(name))):
        pytest.skip("the backend is another here, or does not run this chip")

    def made():
        return SpikingController(artifact, chip(name), backend=backend, trace=True)

    used = check_copies(made, act, rows())
    assert used.ledger.total("spike_out") > 0


PROGRAMS = {
    "a kept state": lambda: policy("synaptic", "zero"),
    "a reset state": lambda: policy("synaptic", "zero", "reset"),
    "delays": lambda: policy("synaptic", "zero", delay=1),
    "a readout": popsan,
    "leak, subtraction": lambda: replace(
        spiking_mlp(), convention=Convention(1e-3, "subtract", state="kept")
    ),
    "events": lambda: event_driven(timesteps=3),
    "graded spikes": delta_network,
}


@pytest.mark.parametrize("name", ["ideal", "loihi1", "loihi2"])
@pytest.mark.parametrize("what", PROGRAMS)
def test_copies_of_a_used_machine_act_as_it_does_in_inferences_and_steps(what, name):
    try:
        program = compile_program(PROGRAMS[what](), chip(name), limits=False)
    except RuleError:
        pytest.skip("the chip has no such neurons")
    whole = spikes(8, 3, 4, program.width)
    for backend in backends(program):

        def made(rows="each", backend=backend):
            return Machine(program, 3, rows, trace=True, backend=backend)

        check_copies(made, infer, whole)
        check_copies(lambda: made("total"), step, whole[:, :, 0])


def test_a_copy_has_what_was_sent_in_the_last_step():
    machine = Machine(compile_program(policy("synaptic", "zero"), chip("loihi1")))
    for _ in range(4):
        machine.step(spikes(1, OBSERVED) | 1)
    name = machine.program.layers[0].name
    copied, sent = copy.deepcopy(machine), machine.sent(name).copy()
    assert sent.any()
    machine.step(spikes(1, OBSERVED) * 0)
    np.testing.assert_array_equal(copied.sent(name), sent)


@pytest.mark.parametrize("backend", ["numpy", "interpreter"])
def test_copies_draw_the_same_upsets(backend):
    program = inject(
        compile_program(policy("synaptic", "zero"), chip("loihi1")),
        faults(["dead-neurons:1", "lost-spikes=0.2", "state-flips=0.01", "spurious-spikes=0.1"]),
    )

    def made():
        machine = Machine(program, 3, trace=True, backend=backend)
        machine.seed((4, 5, 6))
        return machine

    raster = spikes(8, 3, 5, OBSERVED)
    whole = check_copies(made, infer, raster)
    copied = copy.copy(whole)
    assert [each.hit for each in copied.damage] == [each.hit for each in whole.damage]


@pytest.mark.parametrize("chip_name", [None, "ideal"])
@pytest.mark.parametrize("what", ["a readout", "events", "leak, subtraction", "delays"])
def test_copies_of_controllers_in_float_and_sampled_act_as_they_do(what, chip_name):
    artifact = PROGRAMS[what]()
    observed = artifact.codec.encoder.observed
    sampled = artifact.codec.chooses
    on = chip_name and chip(chip_name)
    limits = {"limits": False} if on else {}
    check_copies(
        lambda: SpikingController(artifact, on, "copies", sampled, **limits),
        act,
        rows(3, observed=observed),
    )


def test_copies_of_the_float_twin_act_as_it_does():
    for what in PROGRAMS:
        artifact = PROGRAMS[what]()
        width = int(np.prod(next(iter(artifact.graph.inputs.values())).input_type["input"]))
        for_each = spikes(STEPS, 2, 5, width)
        if what != "graded spikes":
            check_copies(
                lambda: FloatMachine(artifact),  # noqa: B023
                lambda twin, raster: (twin.infer(raster), *twin.spikes.values()),
                for_each,
            )


@pytest.mark.parametrize("backend", ["interpreter", "auto"])
def test_copies_of_an_event_machine_act_as_it_does(backend):
    program = compile_program(policy("integrators", "zero"), chip("speck2f:queue=on"))
    events = np.random.default_rng(1).integers(0, OBSERVED, (STEPS, 9))

    def process(machine, neurons):
        sent = machine.process(neurons).values()
        return *(each for rows in sent for each in rows), *machine.membrane.values()

    check_copies(lambda: EventMachine(program, backend), process, events)


@pytest.mark.parametrize("way", WAYS.values())
def test_what_has_no_exact_copy_is_refused_in_a_sentence(way):
    program = compile_program(popsan(), chip("loihi1"))
    backend = type(Machine(program)._build("window", 5, 1))
    with pytest.raises(ConfigError, match=r"made by a function.*Make another machine"):
        way(Machine(program, backend=lambda *given: backend(*given)))
    with pytest.raises(ConfigError, match=r"NumpyPipeline cannot be copied.*Copy the Machine"):
        way(Machine(program)._build("window", 5, 1))
