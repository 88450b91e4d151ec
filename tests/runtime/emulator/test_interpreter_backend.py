"""The machine's slow way: the interpreter behind the same calls, for every arithmetic there is."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spikedeploy.runtime.emulator.machine import Machine
from spikedeploy.runtime.errors import ConfigError, ObservationError
from tests.paths import GOLDEN
from tests.programs import random_programs, rasters
from tests.trace_files import recorded_trace

runs = st.tuples(
    st.sampled_from([1, 3]),  # batch
    st.sampled_from([1, 4]),  # timesteps
    st.sampled_from([0.1, 0.5, 1.0]),  # rate
    st.integers(0, 2**32 - 1),
)


def check_same(one, other):
    """Two machines left the same recordings, states and counts."""
    for name, found in one.recordings.items():
        for quantity in ("current", "membrane", "spikes"):
            shown = getattr(other.recordings[name], quantity)
            np.testing.assert_array_equal(getattr(found, quantity), shown)
    for name in one.membrane:
        np.testing.assert_array_equal(one.membrane[name], other.membrane[name])
        np.testing.assert_array_equal(one.current[name], other.current[name])
    np.testing.assert_array_equal(one.ledger.counts, other.ledger.counts)
    assert one.ledger.steps == other.ledger.steps
    assert one.ledger.timesteps == other.ledger.timesteps


@settings(max_examples=25)
@given(random_programs(), runs)
def test_interpreted_steps_equal_the_kernels_and_their_ledger(program, run):
    fast, slow = Machine(program, run[0]), Machine(program, run[0], backend="interpreter")
    raster = rasters(program, run[0], 7, *run[2:])[0]
    for row in raster.swapaxes(0, 1):
        np.testing.assert_array_equal(slow.step(row), fast.step(row))
        check_same(slow, fast)


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("xylo_B_two_syn_bias_rec", "layer .*: neurons with several currents"),
        ("lava_own_exponent_mixed", "layer 'layer0': its weights have a negative exponent"),
    ],
)
def test_the_compiled_backend_refuses_what_it_does_not_know(name, reason):
    recorded = recorded_trace(GOLDEN / f"{name}.json")
    with pytest.raises(ConfigError, match=reason):
        Machine(recorded.program, backend="numba")


def test_a_channel_of_xylo_takes_fifteen_events_in_a_timestep():
    machine = Machine(recorded_trace(GOLDEN / "xylo_A_ff.json").program)
    machine.infer(np.full((1, 2, machine.program.width), 15, np.uint8))
    with pytest.raises(ObservationError, match="0 to 15"):
        machine.infer(np.full((1, 2, machine.program.width), 16, np.uint8))
