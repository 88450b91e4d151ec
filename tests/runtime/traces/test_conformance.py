"""Equal to other emulators of chips, and to one neuron of a board, in all that they recorded."""

import json

import numpy as np
import pytest

from spikedeploy.runtime.emulator.machine import Machine
from spikedeploy.runtime.traces.verify import verify
from tests.paths import GOLDEN
from tests.trace_files import recorded_trace

TRACES = sorted(path for path in GOLDEN.glob("*.json") if path.name[:6] != "sanafe")
LOIHI = [path for path in TRACES if "xylo" not in path.name]
# lava rounds sums where an exponent is negative, which only the interpreter does
FAST = [path for path in LOIHI if "lava_own_exponent" not in path.name]
# one neuron of a Loihi 2, NIR paper, 01_lif: spikes in, membrane, spikes out
BOARD = GOLDEN / "board" / "loihi2_lif.json"


def name(path):
    return path.stem


def check(recorded, ran):
    for layer, quantities in recorded.items():
        for quantity, expected in quantities.items():
            found = getattr(ran[layer], quantity)
            np.testing.assert_array_equal(found[0], expected)


def test_there_are_traces_to_compare_with():
    makers = [path.stem.split("_")[0] for path in TRACES]
    tools = ("lava", "brian2loihi", "nengoloihi", "xylo")
    assert [makers.count(tool) for tool in tools] == [14, 10, 8, 5]


@pytest.mark.parametrize("path", TRACES, ids=name)
def test_a_trace_is_verified(path):
    verdict = verify(path)
    assert verdict.difference is None
    assert verdict.compared >= 600
    assert verdict.unread == ()


def test_a_loihi_2_board_gives_every_spike_and_all_membranes_but_those_at_its_four_spikes():
    verdict, recorded = verify(BOARD), recorded_trace(BOARD)
    membrane, spikes = (recorded.recorded["layer0"][each] for each in ("membrane", "spikes"))
    assert (verdict.chip, verdict.steps, verdict.equal) == ("loihi2", 1000, True)
    assert (verdict.compared, verdict.passed_over) == (1996, 4)
    assert np.flatnonzero(spikes).tolist() == [461, 511, 711, 761]
    assert (membrane[spikes == 1] == 128).all()  # the probe's, documented nowhere
    assert membrane.min() == 0  # so the rounding of negative numbers is not tested by it


@pytest.mark.parametrize("changed", [{"dv": 162}, {"vth": 26}, {"weights": [[11]]}])
def test_another_neuron_than_the_board_s_is_not_equal_to_its_trace(changed, tmp_path):
    fields = json.loads(BOARD.read_text())
    fields["params"] |= changed
    (tmp_path / BOARD.name).write_text(json.dumps(fields))
    assert not verify(tmp_path / BOARD.name).equal


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
