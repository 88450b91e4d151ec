"""Equal to other emulators of chips in every current, membrane and spike, each in its reading."""

import numpy as np
import pytest

from spikedeploy.runtime.emulator.interpreter import trace
from spikedeploy.runtime.emulator.machine import Machine
from spikedeploy.runtime.traces.verify import verify
from tests.paths import GOLDEN
from tests.trace_files import recorded_trace

TRACES = sorted(path for path in GOLDEN.glob("*.json") if path.name[:6] != "sanafe")
LOIHI = [path for path in TRACES if "xylo" not in path.name]
# lava rounds sums where an exponent is negative, which only the interpreter does
FAST = [path for path in LOIHI if "lava_own_exponent" not in path.name]


def name(path):
    return path.stem


def check(recorded, ran):
    for layer, quantities in recorded.items():
        for quantity, expected in quantities.items():
            found = getattr(ran[layer], quantity)
            np.testing.assert_array_equal(found[0], expected)


def test_there_are_traces_to_compare_with():
    makers = [path.stem.split("_")[0] for path in TRACES]
    assert [makers.count(m) for m in ("lava", "brian2loihi", "nengoloihi", "xylo")] == [10, 6, 5, 5]


@pytest.mark.parametrize("path", TRACES, ids=name)
def test_a_trace_is_verified(path):
    verdict = verify(path)
    assert verdict.difference is None
    assert verdict.compared >= 600
    assert verdict.unread == ()


@pytest.mark.parametrize("path", LOIHI, ids=name)
def test_the_interpreter_equals_the_trace(path):
    recorded = recorded_trace(path)
    assert all(len(quantities) == 3 for quantities in recorded.recorded.values())
    check(recorded.recorded, trace(recorded.program, recorded.raster))


@pytest.mark.parametrize("path", FAST, ids=name)
def test_the_machine_equals_the_trace(path):
    recorded = recorded_trace(path)
    machine = Machine(recorded.program, trace=True)
    machine.infer(recorded.raster)
    check(recorded.recorded, machine.recordings)


@pytest.mark.parametrize("path", FAST, ids=name)
def test_streaming_equals_the_trace(path):
    recorded = recorded_trace(path)
    machine = Machine(recorded.program)
    for t in range(recorded.raster.shape[1]):
        machine.step(recorded.raster[:, t])
        for layer, expected in recorded.recorded.items():
            np.testing.assert_array_equal(machine.current[layer][0], expected["current"][t])
            np.testing.assert_array_equal(machine.membrane[layer][0], expected["membrane"][t])
