"""The machine is fast and equal to the interpreter, which is short and right."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.programs import random_programs, rasters

from runtime.interpreter import Interpreter
from runtime.ledger import count
from runtime.machine import Machine

runs = st.tuples(
    st.sampled_from([1, 2, 3]),  # batch
    st.sampled_from([1, 2, 5, 9]),  # timesteps
    st.sampled_from([0.0, 0.1, 0.5, 1.0]),  # rate
    st.integers(0, 2**32 - 1),
)


@settings(max_examples=150, deadline=None)
@given(random_programs(), runs)
def test_the_machine_equals_the_interpreter_in_every_current_membrane_and_spike(program, run):
    batch, *_ = run
    machine = Machine(program, batch, trace=True)
    interpreter = Interpreter(program, batch)
    for raster in rasters(program, *run, inferences=3):
        if program.convention.state == "reset":
            interpreter = Interpreter(program, batch)
        expected = interpreter.run(raster)
        output = machine.infer(raster)
        for name, found in machine.recordings.items():
            np.testing.assert_array_equal(found.current, expected[name].current)
            np.testing.assert_array_equal(found.membrane, expected[name].membrane)
            np.testing.assert_array_equal(found.spikes, expected[name].spikes)
        np.testing.assert_array_equal(output, expected[program.output].spikes)
        counts = count(
            program,
            {program.input: raster, **{name: t.spikes for name, t in expected.items()}},
            {name: t.busy for name, t in expected.items()},
            {name: t.overflows for name, t in expected.items()},
        )
        np.testing.assert_array_equal(machine.ledger.counts[-batch:], counts)
