"""Speck event by event: traces, by hand, and the compiled kernel beside its specification."""

import json
import shutil
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.chips.convolution import Window
from spikedeploy.runtime.chips.layer import Synapses, plain_layer
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.emulator.interpreter import trace
from spikedeploy.runtime.emulator.ledger import EVENTS
from spikedeploy.runtime.emulator.machine import Machine
from spikedeploy.runtime.errors import (
    ChipError,
    ConfigError,
    ObservationError,
    RuleError,
    TraceError,
)
from spikedeploy.runtime.families.integrate_and_fire.arithmetic import quantise
from spikedeploy.runtime.families.integrate_and_fire.event_machine import EventMachine
from spikedeploy.runtime.traces.verify import verify
from tests.paths import GOLDEN

TRACES = sorted((GOLDEN / "speck").glob("*.json"))


def name(path):
    return path.stem


@pytest.mark.parametrize("path", TRACES, ids=name)
def test_a_trace_of_sinabs_and_of_events_is_equal(path):
    verdict = verify(path)
    assert verdict.difference is None
    assert verdict.compared > 10_000
    assert verdict.unread == ()
    # the networks have no biases, and their traces do not say so
    assert all("so taken as speck2f has it: bias 0" in each for each in verdict.remarks)


@pytest.mark.parametrize("path", TRACES, ids=name)
def test_weights_and_biases_are_rounded_as_sinabs_rounds_them(path):
    record, rules = json.loads(path.read_text()), chip("speck2f").arithmetic
    with np.load(path.with_suffix(".npz")) as arrays:
        for k, spec in enumerate(record["layers"]):
            weight = arrays[f"float_weight_{k}"].astype(float).reshape(len(spec["weights"]), -1).T
            layer = plain_layer("n", [Synapses("input", weight, 0)], np.ones(weight.shape[1]))
            bias = arrays.get(f"float_bias_{k}", np.zeros(1)).astype(float) * layer.threshold
            layer = replace(layer, bias=bias, membrane_decay=np.ones(layer.size))
            found = quantise(layer, "speck2f", rules, None, limits=True)
            wanted = arrays[f"weight_{k}"].reshape(len(spec["weights"]), -1).T
            np.testing.assert_array_equal(found.synapses[0].weight, wanted)
            np.testing.assert_array_equal(found.bias + found.voltage_bias, spec["bias"] or 0)


def test_a_trace_without_its_arrays_is_refused(tmp_path):
    shutil.copy(TRACES[1], tmp_path)
    with pytest.raises(TraceError, match="arrays of the trace are missing"):
        verify(tmp_path / TRACES[1].name)


@pytest.mark.parametrize(
    ("key", "change"),
    [
        ("timestep_v_1", 1),
        ("timestep_spikes_0", 1),
        ("event_single_cyx_spikes_1", 1),
        ("event_single_cyx_v_0", 1),
        ("event_multi_yxc_v_end_1", 1),
    ],
)
def test_one_other_number_is_a_difference(key, change, tmp_path):
    shutil.copy(TRACES[1], tmp_path)
    with np.load(TRACES[1].with_suffix(".npz")) as members:
        arrays = dict(members)
    arrays[key][(len(arrays[key]) // 2, *(0,) * (arrays[key].ndim - 1))] += change
    np.savez(tmp_path / TRACES[1].with_suffix(".npz").name, **arrays)
    difference = verify(tmp_path / TRACES[1].name).difference
    assert difference is not None
    assert key.rpartition("_")[0] in difference.describe()


@pytest.mark.parametrize(
    ("field", "value", "said"),
    [
        ("format", "speck-trace-2", "format is"),
        ("input", [2, 9], r"input has shape \(2,\)"),
        ("events_in", [[0, 2, 0, 0]], "an event outside"),
        ("layers", [], "layers has 0"),
    ],
)
def test_a_trace_that_cannot_be_replayed_is_refused(field, value, said, tmp_path):
    fields = json.loads(TRACES[1].read_text()) | {field: value}
    (tmp_path / "trace.json").write_text(json.dumps(fields))
    shutil.copy(TRACES[1].with_suffix(".npz"), tmp_path / "trace.npz")
    if field == "events_in":
        with np.load(TRACES[1].with_suffix(".npz")) as members:
            arrays = dict(members) | {field: np.array(value)}
        np.savez(tmp_path / "trace.npz", **arrays)
    with pytest.raises(Exception, match=said):
        verify(tmp_path / "trace.json")


# by hand


def network(*layers, reset="subtract", **options):
    """A chain of (kernel, Window, threshold), or (matrix, None, threshold), event by event."""
    made, source = [], "input"
    for k, (weight, window, threshold) in enumerate(layers):
        weight = np.array(weight, np.int16)
        synapses = Synapses(source, weight, 0, window=window)
        ones = np.ones(synapses.shape[1], np.int64)
        made.append(plain_layer(f"n{k}", [synapses], threshold * ones))
        source = f"n{k}"
    width = made[0].synapses[0].shape[0]
    convention = Convention(1e-3, reset, spikes="many")
    on = chip("speck2f", **{"queue": "on", **options})
    return Program(on, convention, "input", width, tuple(made), source, None)


def one_row(kernel, threshold, **options):
    """A kernel of (3,) along a row of four."""
    window = Window((1, 1, 4), (1, 1, 4), (1, 3), padding=(0, 1))
    return network((np.reshape(kernel, (1, 1, 1, 3)), window, threshold), **options)


def rows(spikes):
    return list(zip(spikes.cause.tolist(), spikes.neuron.tolist(), strict=True))


BACKENDS = pytest.mark.parametrize("backend", ["interpreter", "numba"])


@BACKENDS
def test_only_neurons_that_an_event_reaches_are_touched(backend):
    # 25 at threshold 10: one spike for an event, and 15 are left. Event at 3 reaches 2 and 3, with
    # weights of 0 but for its own place: neuron 2 is looked at and fires, 0 and 1 are not
    machine = EventMachine(one_row([0, 25, 0], 10), backend)
    assert rows(machine.process(np.array([0, 2, 3]))["n0"]) == [(0, 0), (1, 2), (2, 2), (2, 3)]
    assert machine.membrane["n0"].tolist() == [15, 0, 5, 15]
    found = dict(zip(EVENTS, machine.ledger.counts[0, 0].tolist(), strict=True))
    assert (found["sop"], found["neuron_update"], found["neuron_idle"]) == (3, 2 + 3 + 2, 0)


@BACKENDS
@pytest.mark.parametrize(
    ("options", "sent", "left"),
    [
        ({}, 1, 15),
        ({"event_spikes": "multi"}, 2, 5),
        ({"reset": "zero"}, 1, 0),
        ({"event_spikes": "multi", "reset": "zero"}, 2, 0),
    ],
)
def test_the_spikes_of_an_event_and_what_they_leave(options, sent, left, backend):
    machine = EventMachine(one_row([0, 25, 0], 10, **options), backend)
    assert rows(machine.process(np.array([1]))["n0"]) == [(0, 1)] * sent
    assert machine.membrane["n0"][1] == left


@BACKENDS
def test_spikes_of_an_event_leave_channel_after_channel_or_place_after_place(backend):
    window = Window((1, 1, 2), (2, 1, 2), (1, 3), padding=(0, 1))
    layer = np.full((2, 1, 1, 3), 9), window, 5
    first = EventMachine(network(layer), backend).process(np.array([0]))["n0"]
    second = EventMachine(network(layer, event_order="yxc"), backend).process(np.array([0]))["n0"]
    assert first.neuron.tolist() == [0, 1, 2, 3]
    assert second.neuron.tolist() == [0, 2, 1, 3]


@BACKENDS
def test_a_pool_passes_every_event_on_and_loses_what_is_left_over(backend):
    window = Window((1, 1, 5), (1, 1, 2), (1, 1), pool=(1, 2))
    machine = EventMachine(network(([[[[7]]]], window, 5)), backend)
    assert rows(machine.process(np.array([4, 3, 2, 0]))["n0"]) == [(1, 1), (2, 1), (3, 0)]


@BACKENDS
def test_membranes_are_16_bits_and_saturate(backend):
    machine = EventMachine(network(([[-100, 127]], None, [32767, 32767])), backend)
    machine.process(np.zeros(400, np.int64))
    # 127 * 258 = 32,766; then 32,893 is held as 32,767, which is the threshold
    assert machine.membrane["n0"].tolist() == [-32768, 127 * 141]
    assert machine.ledger.total("saturation") == (400 - 327) + 1


# the compiled kernel, streams, timesteps


def random_network(seed, order, rule):
    """Two layers of windows, pools, strides, groups and dilations, and a matrix."""
    rng = np.random.default_rng(seed)
    shape, pool, layers = (int(rng.integers(1, 3)) * 2, 9, 8), (1, 1), []
    for _ in range(2):
        groups = int(rng.choice([1, 2]))
        kernel, stride, dilation, padding = (
            tuple(int(n) for n in rng.integers(low, high, 2))
            for low, high in ((1, 4), (1, 3), (1, 3), (0, 3))
        )
        behind = [n // p for n, p in zip(shape[1:], pool, strict=True)]
        places = [
            (n + 2 * p - d * (k - 1) - 1) // s + 1
            for n, p, d, k, s in zip(behind, padding, dilation, kernel, stride, strict=True)
        ]
        if min(places) < 1:
            break
        target = (4, *places)
        window = Window(shape, target, kernel, pool, stride, padding, dilation, groups)
        weight = rng.integers(-60, 90, (4, shape[0] // groups, *kernel))
        layers.append((weight, window, rng.integers(20, 200)))
        shape, pool = target, tuple(int(n) for n in rng.integers(1, 3, 2))
    size = int(np.prod(shape))
    layers.append((rng.integers(-60, 90, (size, 5)), None, rng.integers(20, 200, 5)))
    reset = str(rng.choice(["zero", "subtract"]))
    return network(*layers, reset=reset, event_order=order, event_spikes=rule), rng


@settings(max_examples=12)
@given(st.integers(0, 2**32 - 1), st.sampled_from(["cyx", "yxc"]), st.booleans())
def test_the_kernel_equals_its_specification_in_spikes_membranes_and_counts(seed, order, multi):
    program, rng = random_network(seed, order, "multi" if multi else "single")
    events = rng.integers(0, program.width, 300)
    machines = [EventMachine(program, backend) for backend in ("interpreter", "numba")]
    first, second = (machine.process(events) for machine in machines)
    for layer in first:
        np.testing.assert_array_equal(first[layer].cause, second[layer].cause)
        np.testing.assert_array_equal(first[layer].neuron, second[layer].neuron)
        np.testing.assert_array_equal(*(machine.membrane[layer] for machine in machines))
    np.testing.assert_array_equal(*(machine.ledger.counts for machine in machines))


def test_a_stream_in_parts_is_the_stream():
    program, rng = random_network(7, "cyx", "single")
    events = rng.integers(0, program.width, 9000)
    whole, parted = EventMachine(program), EventMachine(program)
    expected = whole.process(events)
    ends = [0, 1, 5000, 5000, 9000]
    parts = [parted.process(events[a:b]) for a, b in pairwise(ends)]
    for layer, spikes in expected.items():
        assert len(spikes.neuron)
        found = np.concatenate([part[layer].neuron for part in parts])
        causes = [p[layer].cause + a for p, a in zip(parts, ends, strict=False)]
        np.testing.assert_array_equal(found, spikes.neuron)
        np.testing.assert_array_equal(np.concatenate(causes), spikes.cause)
    np.testing.assert_array_equal(whole.ledger.counts, parted.ledger.counts)


@pytest.mark.parametrize("order", ["cyx", "yxc"])
def test_a_timestep_s_counts_are_events_in_the_order_of_spikes(order):
    program, rng = random_network(11, order, "single")
    counts = rng.integers(0, 3, (2, 6, program.width), dtype=np.uint8)
    found = trace(program, counts)
    channels, y, x = program.layers[0].synapses[0].window.source
    places = np.arange(program.width).reshape(channels, y, x)
    ordered = places.ravel() if order == "cyx" else places.transpose(1, 2, 0).ravel()
    for copy in range(2):
        machine = EventMachine(program, "interpreter")
        for t, row in enumerate(counts[copy]):
            sent = machine.process(np.repeat(ordered, row[ordered]))
            for layer in found:
                spikes = np.bincount(sent[layer].neuron, minlength=found[layer].spikes.shape[2])
                np.testing.assert_array_equal(found[layer].spikes[copy, t], spikes)
                held = found[layer].membrane[copy, t]
                np.testing.assert_array_equal(held, machine.membrane[layer])
    ran = {}
    for backend in ("interpreter", "numba"):
        ran[backend] = machine = Machine(program, batch=2, backend=backend)
        machine.infer(counts)
    np.testing.assert_array_equal(*(machine.ledger.counts for machine in ran.values()))


# refusals


def test_what_has_no_place_event_by_event_is_refused():
    program = one_row([0, 25, 0], 10)
    with pytest.raises(ConfigError, match="does not go event by event"):
        EventMachine(replace(program, chip=chip("speck2f")))
    machine = EventMachine(program)
    with pytest.raises(ObservationError, match="event of neuron 4: the input has the neurons 0"):
        machine.process(np.array([0, 4]))
    with pytest.raises(ObservationError, match=r"\(E,\) integers"):
        machine.process(np.zeros((2, 3)))
    with pytest.raises(ChipError, match="events have no timesteps to leak in"):
        chip("tinyodin", event_order="cyx")
    arithmetic, (layer,) = program.chip.arithmetic, program.layers
    biased = replace(layer, bias=np.ones(4))
    loop = replace(layer, synapses=(*layer.synapses, replace(layer.synapses[0], source="n0")))
    for wrong, said in ((biased, "rule bias"), (loop, "rule recurrence")):
        with pytest.raises(RuleError, match=said):
            arithmetic.prepare([wrong], "input", program.convention, 0, waits=False)
