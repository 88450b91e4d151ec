"""What is compared where a machine must equal the interpreter, bit for bit."""

import numpy as np
from hypothesis import strategies as st

from spikedeploy.runtime.emulator.interpreter import Interpreter, count
from spikedeploy.runtime.emulator.machine import Machine
from tests.programs import rasters

runs = st.tuples(
    st.sampled_from([1, 2, 3]),  # batch
    st.sampled_from([1, 2, 5, 9]),  # timesteps
    st.sampled_from([0.0, 0.1, 0.5, 1.0]),  # rate
    st.integers(0, 2**32 - 1),
)


def check_equal(recordings, traces):
    """Every current, membrane and spike."""
    for name, found in recordings.items():
        np.testing.assert_array_equal(found.current, traces[name].current)
        np.testing.assert_array_equal(found.membrane, traces[name].membrane)
        np.testing.assert_array_equal(found.spikes, traces[name].spikes)


def check_like_the_interpreter(program, run, backend):
    """Three inferences of a run: all states, the output, and the ledger's counts."""
    batch, *_ = run
    machine = Machine(program, batch, trace=True, backend=backend)
    interpreter = Interpreter(program, batch)
    for raster in rasters(program, *run, inferences=3):
        if program.convention.state == "reset":
            interpreter = Interpreter(program, batch)
        traces = interpreter.run(raster)
        output = machine.infer(raster)
        check_equal(machine.recordings, traces)
        np.testing.assert_array_equal(output, traces[program.output].spikes)
        counts = count(
            program,
            {program.input: raster, **{name: t.spikes for name, t in traces.items()}},
            traces,
        )
        np.testing.assert_array_equal(machine.ledger.counts[-batch:], counts)
