"""Xylo's arithmetic worked out by hand, and how its traces are read."""

import json

import numpy as np
import pytest

from spikedeploy.runtime.emulator.interpreter import trace
from spikedeploy.runtime.emulator.machine import Machine
from spikedeploy.runtime.errors import TraceError
from spikedeploy.runtime.traces.verdict import TraceDifference
from spikedeploy.runtime.traces.verify import verify
from tests.paths import GOLDEN
from tests.trace_files import recorded_trace


def network(weights, counts, **params):
    """A trace of one hidden and one output neuron that records nothing but the membrane."""
    return {
        "chip": "xylo-a2",
        "params": {
            "weights_in": [[[w]] for w in weights],
            "weights_rec": [[[0]]],
            "weights_out": [[64]],
            "dash_mem": 1,
            "dash_syn": 1,
            "dash_mem_out": 1,
            "dash_syn_out": 1,
            "threshold": 32767,
            "threshold_out": 32767,
            **params,
        },
        "input_counts": counts,
        "v_mem": [[0]] * len(counts),
    }


@pytest.fixture
def file(tmp_path):
    def write(record):
        path = tmp_path / "trace.json"
        path.write_text(json.dumps(record))
        return path

    return write


@pytest.fixture
def ran(file):
    def run(record):
        recorded = recorded_trace(file(record))
        return trace(recorded.program, recorded.raster)

    return run


def test_a_trace_worked_out_by_hand(ran):
    # t  arrives  current, less half rounded down  membrane, less half, plus current   spikes of 5
    # 0  3 * 10   30 - 15 = 15                     15                                  3, leaves 0
    # 1  -        15 - 7 = 8                       8                                   1, leaves 3
    # 2  -        8 - 4 = 4                        3 - 1 + 4 = 6                       1, leaves 1
    # 3  -20      4 - 20 = -16, + 8 = -8           1 - 1 (not 0) - 8 = -8              none
    # 4  -        -8 + 4 = -4                      -8 + 4 - 4 = -8                     none
    # 5  -        -4 + 2 = -2                      -8 + 4 - 2 = -6                     none
    record = network([10, -20], [[3, 0], [0, 0], [0, 0], [0, 1], [0, 0], [0, 0]], threshold=5)
    hidden = ran(record)["hidden"]
    assert hidden.current[0, :, 0].ravel().tolist() == [15, 8, 4, -8, -4, -2]
    assert hidden.spikes.ravel().tolist() == [3, 1, 1, 0, 0, 0]
    assert hidden.membrane.ravel().tolist() == [0, 3, 1, -8, -8, -6]


def test_every_event_saturates_and_so_their_order_counts(ran):
    # 127 << 8 = 32512 twice saturates; what is taken off then starts from 32767
    raised = network([127, -127], [[2, 1]], weight_shift=[8, 0, 0])
    lowered = network([-127, 127], [[1, 2]], weight_shift=[8, 0, 0])
    assert ran(raised)["hidden"].current.ravel()[0] == (32767 - 32512) - (255 >> 1)
    assert ran(lowered)["hidden"].current.ravel()[0] == 32512 - (32512 >> 1)
    assert ran(raised)["hidden"].overflows.sum() == 1


def test_a_hidden_neuron_spikes_31_times_and_an_output_once(ran):
    record = network([127], [[15], [0]], threshold=1, threshold_out=1)
    hidden, output = (ran(record)[name] for name in ("hidden", "output"))
    assert hidden.spikes.max() == 31
    assert output.spikes.max() == 1
    assert output.membrane[0, 1, 0] == 992 - 1  # 31 * 64, half of it left, less one threshold


@pytest.mark.parametrize(
    ("aliases", "counts", "spikes"),
    [
        # the aliases come later: what is counted for them already is passed on with their own
        (
            [[1], [2], []],
            [[2, 0, 0], [1, 1, 0], [0, 0, 0], [3, 3, 3]],
            [[10, 10, 10], [10, 15, 15], [5, 7, 7], [17, 31, 31]],
        ),
        # they had their turn before: nothing is passed on
        (
            [[], [0], [1]],
            [[0, 0, 2], [1, 1, 1], [0, 0, 0], [3, 3, 3]],
            [[0, 10, 10], [10, 15, 10], [4, 7, 5], [31, 31, 17]],
        ),
        (
            [[1, 2], [0], [0]],
            [[2, 0, 0], [1, 1, 1], [0, 0, 0], [3, 3, 3]],
            [[30, 10, 10], [31, 15, 15], [19, 7, 7], [31, 31, 31]],
        ),
    ],
)
def test_spikes_are_counted_for_aliases_as_in_xylosim(aliases, counts, spikes, ran):
    # spikes as xylosim 0.1.3 gave them for this network
    wide = {
        "weights_in": [[[100], [0], [0]], [[0], [100], [0]], [[0], [0], [100]]],
        "weights_rec": [],
        "weights_out": [[1], [1], [1]],
    }
    record = network([], counts, threshold=10, aliases=aliases, **wide)
    record["v_mem"] = [[0] * 3] * len(counts)
    assert ran(record)["hidden"].spikes[0].tolist() == spikes


def test_the_first_difference_names_the_second_current(file):
    record = json.loads((GOLDEN / "xylo_B_two_syn_bias_rec.json").read_text())
    found = record["i_syn2"][7][3]
    record["i_syn2"][7][3] += 2
    record["v_mem"][7][0] += 1
    expected = TraceDifference(7, "hidden", 3, "current 2", found + 2, found)
    assert verify(file(record)).difference == expected


def test_every_spike_of_a_timestep_is_counted_in_the_ledger(file):
    # 3 events of 10 on one of two channels: 15 of current, 3 spikes of 5; one step later 1 more
    record = network([10, 0], [[3, 0], [0, 2], [0, 0]], threshold=5)
    machine = Machine(recorded_trace(file(record)).program)
    machine.infer(np.array([record["input_counts"]], np.uint8))
    ledger = machine.ledger
    assert ledger.by_layer("spike_in") == {"hidden": 5 + 5, "output": 5}
    # channel 1 and the recurrent synapse have weight 0, and so no fan-out
    assert ledger.by_layer("sop") == {"hidden": 3, "output": 5}
    assert ledger.by_layer("spike_out") == {"hidden": 3 + 1 + 1, "output": 0}
    assert ledger.by_layer("message") == {"hidden": 10, "output": 5}


@pytest.mark.parametrize("name", ["xylo-a2", "xylo-a3", "xylo-imu"])
def test_traces_of_every_xylo_are_replayed(name, file):
    record = json.loads((GOLDEN / "xylo_A_ff.json").read_text()) | {"chip": name}
    verdict = verify(file(record))
    assert (verdict.chip, verdict.difference, verdict.unread) == (name, None, ())


def test_a_neuron_of_xylo_imu_has_one_synapse(file):
    record = network([], [[1]], weights_in=[[[1, 2]]]) | {"chip": "xylo-imu"}
    with pytest.raises(TraceError, match="A neuron has 1 synapses at most"):
        verify(file(record))


def test_the_lowest_membrane_that_forgets_at_once_stays_where_it_is(ran):
    # as xylosim 0.1.3: -32768 is its own negative in 16 bits, so the leak does not lift it
    record = network([-127, 127], [[15, 0], [0, 0], [0, 15]], dash_mem=0, weight_shift=[8, 0, 0])
    membrane = ran(record | {"params": {**record["params"], "bias": -30000}})["hidden"].membrane
    assert membrane.ravel().tolist() == [-32768] * 3
    lifted = ran(record | {"params": {**record["params"], "bias": -30000, "dash_mem": 1}})["hidden"]
    # 16384 + 16384 saturates to 32767; -32768 + 32767 - 30000
    assert lifted.membrane.ravel().tolist() == [-32768, -32768, -30001]


@pytest.mark.parametrize(
    ("params", "message"),
    [
        ({"aliases": [[], []]}, "aliases has 2 lists"),
        ({"aliases": [[0]]}, "neuron 0 name itself"),
        *(({"aliases": wrong}, "aliases") for wrong in ([[7]], [[True]], 1)),
        *(({"weights_in": wrong}, "weights_in") for wrong in ([[[200]]], [[[1]], [[1]]], 1)),
        ({"weights_in": [[[1, 2, 3]]]}, "2 synapses at most"),
        ({"weights_rec": [[[0]], [[0]]]}, "weights_rec has"),
        ({"weights_out": [[1], [1]]}, "weights_out has 2 rows"),
        ({"weights_out": [[[1, 2]]]}, "Outputs have one synapse"),
        *(({"weight_shift": wrong}, "weight_shift") for wrong in ([10**9, 0, 0], [0, 0])),
        ({"dash_mem": 16}, "dash_mem holds 16"),
        *(({name: None}, "threshold is missing") for name in ("threshold", "threshold_out")),
    ],
)
def test_a_broken_trace_is_told_what_is_wrong(params, message, file):
    with pytest.raises(TraceError, match=message):
        verify(file(network([1], [[1]], **params)))
