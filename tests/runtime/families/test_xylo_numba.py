"""Compiled Xylo neurons equal the interpreter, saturating sums and counts of events included."""

from dataclasses import replace
from importlib.util import find_spec

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.compiler.compile import compile_program
from spikedeploy.runtime.emulator.backend import backend_class
from spikedeploy.runtime.emulator.interpreter import trace
from spikedeploy.runtime.emulator.machine import Machine
from spikedeploy.runtime.errors import ConfigError
from tests.equality import check_equal, check_like_the_interpreter, runs
from tests.programs import rasters
from tests.xylo_networks import random_cores, random_networks

pytestmark = pytest.mark.skipif(
    find_spec("numba") is None, reason="numba is not installed (pip install '.[fast]')"
)


def with_one_current(program):
    """The program without second currents and aliases."""
    layers = tuple(
        replace(
            layer,
            synapses=tuple(s for s in layer.synapses if not s.current),
            current_decay=layer.current_decay[:1],
            aliases=(),
        )
        for layer in program.layers
    )
    return replace(program, layers=layers)


@settings(max_examples=60)
@given(random_cores(), st.sampled_from(["reset", "kept"]), runs)
def test_it_equals_the_interpreter_in_every_state_spike_and_count(core, state, run):
    program = with_one_current(core[0])
    kept = replace(program, convention=replace(program.convention, state=state))
    check_like_the_interpreter(kept, run, "numba")


@settings(max_examples=30)
@given(random_networks(), runs)
def test_networks_that_are_compiled_for_it_do_too(artifact, run):
    batch, *_ = run
    program = compile_program(artifact, chip("xylo-a2"), limits=False)
    ours, theirs = (Machine(program, batch, "each", True, b) for b in ("numba", "interpreter"))
    for raster in rasters(program, *run, inferences=2):
        np.testing.assert_array_equal(ours.infer(raster), theirs.infer(raster))
        check_equal(ours.recordings, theirs.recordings)
    np.testing.assert_array_equal(ours.ledger.counts, theirs.ledger.counts)


@settings(max_examples=30)
@given(random_cores(), st.integers(0, 2**32 - 1))
def test_up_to_15_events_of_an_axon_in_a_timestep_do_too(core, seed):
    program = with_one_current(core[0])
    counts = np.random.default_rng(seed).integers(0, 16, (2, 9, program.width)).astype(np.uint8)
    machine = Machine(program, 2, trace=True, backend="numba")
    machine.infer(counts)
    check_equal(machine.recordings, trace(program, counts))


@settings(max_examples=5)
@given(random_cores())
def test_two_currents_are_left_to_the_interpreter(core):
    program, _ = core
    assert backend_class(program, "auto").__name__ == "InterpreterBackend"
    with pytest.raises(ConfigError, match="several currents"):
        backend_class(program, "numba")
