"""Equal to simulations of the RTL of ODIN, tinyODIN and Spiker+, recorded and by a plain model."""

import json
from functools import partial

import numpy as np
import pytest

from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.chips.layer import Layer, Synapses
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.emulator.interpreter import Interpreter
from spikedeploy.runtime.errors import TraceError
from spikedeploy.runtime.traces.verify import verify
from tests.paths import GOLDEN
from tests.rtl_reference import ODIN, TINYODIN, random_odin, random_spiker

RECORDED = sorted((GOLDEN / "rtl").glob("*.json"))
ODINS = [path for path in RECORDED if "spiker" not in path.name]


def name(path):
    return path.stem


@pytest.fixture
def judged(tmp_path):
    def judge(record):
        path = tmp_path / "trace.json"
        path.write_text(json.dumps(record))
        return verify(path)

    return judge


@pytest.mark.parametrize("path", RECORDED, ids=name)
def test_a_simulation_of_the_rtl_is_verified(path):
    verdict = verify(path)
    assert verdict.difference is None
    assert verdict.compared >= 3000
    assert verdict.unread == ()


def test_a_host_that_never_waits_is_equal_event_by_event_with_the_spikes_that_it_lost(judged):
    record = json.loads((GOLDEN / "rtl" / "odin_two_layers_stream.json").read_text())
    assert len(record["dropped_by_full_fifo"]) == 191
    (remark,) = verify(GOLDEN / "rtl" / "odin_two_layers_stream.json").remarks
    assert "the host never waits" in remark
    assert "lost spikes included" in remark
    del record["events"]
    (remark,) = judged(record).remarks
    assert "the host never waits" in remark
    assert "lost spikes" not in remark


def program_of(record):
    """The trace as a program of the chip; its membranes before the first event are apart."""
    spec = record["params"]
    weights, size = np.array(record["weights"], np.int16), len(spec["thr"])
    closed = spec["closed_loop"]
    datasheet = chip(record["chip"], queue="on" if closed else "off", host=spec["host"])
    synapses = [Synapses("input", weights, 0)]
    if closed:
        synapses.append(Synapses("neurons", np.array(record["weights_rec"], np.int16), 1))
    none = np.zeros(size, np.int64)
    arrays = np.array(spec["thr"], np.int64), none, np.array(spec["leak"], np.int64)
    layer = Layer("neurons", tuple(synapses), none, none, *arrays, 1.0, 0)
    return Program(datasheet, Convention(1e-3), "input", len(weights), (layer,), "neurons", None)


def run_program(record):
    """Membranes and spikes (T, N) of the interpreter, and the spikes that the queue lost."""
    interpreter = Interpreter(program_of(record), 1)
    interpreter.states["neurons"].membrane = np.array([record["params"]["start"]], np.int64)
    found = interpreter.run(np.array([record["input_spikes"]], np.uint8))["neurons"]
    seen = found.spikes[0] * (1 - np.array(record["params"]["disabled"]))
    return found.membrane[0].tolist(), seen.tolist(), found.lost


PROGRAMS = [path for path in ODINS if path.stem not in
            ("odin_random_order", "odin_two_layers_stream", "odin_layers_relayed")]  # fmt: skip


@pytest.mark.parametrize("path", PROGRAMS, ids=name)
def test_the_interpreter_equals_the_simulation_at_the_end_of_every_timestep(path):
    record = json.loads(path.read_text())
    membrane, spikes, _ = run_program(record)
    assert (membrane, spikes) == (record["v"], record["s"])


# what no recording here has: edges of thresholds, counts, hosts, full queues, registers
ODIN_KINDS = {
    "thresholds from 0": {"thr": [*range(8), 254, 255], "low": -2},
    "counts": {"most": 4},
    "up to 255": {"thr": (250, 256), "most": 9, "low": -1},
    "start and disabled": {"start": list(range(0, 100, 10)), "disabled": [0, 1] * 5},
    "random order": {"order": "random", "most": 2},
    "recurrent": {"loop": True},
    "recurrent with disabled neurons": {"loop": True, "disabled": [0, 0, 1, 0, 1] * 2},
    "recurrent in random order": {"loop": True, "order": "random"},
    "recurrent relayed": {"loop": True, "host": "relays"},
    "step": {"loop": True, "host": "step", "thr": (6, 16)},
    "open loop in steps": {"host": "step"},
    "stream": {"loop": True, "host": "stream", "thr": (6, 16)},
    "full queue": dict(size=96, loop="layers", thr=(6, 20), low=0, steps=6, rate=0.2),
    "full queue in steps": dict(
        size=80, loop="layers", thr=(9, 40), low=-3, steps=6, rate=0.6, host="step"
    ),
    "full queue in a stream": dict(
        size=60, loop="layers", thr=(20, 60), low=-3, steps=12, rate=0.5, host="stream"
    ),
    "spikes at the time reference": dict(
        size=60, loop="layers", thr=(30, 90), start=[200] * 60, steps=3, host="step"
    ),
}
TINYODIN_KINDS = {
    "thresholds": {"thr": [0, 1, 2, 3, 5, 8, 2047, 2048, 4095, 40]},
    "down and up": {"start": [-2000] * 5 + [2000] * 5, "most": 9, "thr": (2040, 2048)},
    "recurrent": {"loop": True, "host": "step"},
    "full queue": dict(size=256, loop="layers", thr=(1, 7), low=3, steps=2, rate=0.3, host="step"),
}
SPIKER_KINDS = {
    "recurrent": dict(sizes=(8, 7), loop=True),
    "three layers": dict(sizes=(9, 8, 7, 6), shift=5),
    "loops, fixed reset": dict(sizes=(9, 8, 7), loop=True, reset="fixed", v_reset=(-9, 10)),
    "narrow": dict(sizes=(20, 9), bits=6, shift=9, rate=0.8, threshold=(5, 30)),
    "wide weights": dict(sizes=(8, 7), weight=8, threshold=(50, 200)),
    "thresholds below 0": dict(sizes=(8, 7, 6), threshold=(-9, 3), reset="fixed", loop=True),
    **{f"shift {n}": dict(sizes=(8, 6), shift=n) for n in (0, 1, 10)},
}
KINDS = {
    **{f"odin, {name}": partial(random_odin, ODIN, **of) for name, of in ODIN_KINDS.items()},
    **{
        f"tinyodin, {name}": partial(random_odin, TINYODIN, **of)
        for name, of in TINYODIN_KINDS.items()
    },
    **{f"spiker, {name}": partial(random_spiker, **of) for name, of in SPIKER_KINDS.items()},
}


@pytest.mark.parametrize("kind", KINDS)
def test_a_plain_model_of_the_rtl_is_verified(kind, judged):
    record = KINDS[kind](1)
    verdict = judged(record)
    assert verdict.difference is None
    assert verdict.unread == ()
    assert not any("not compared" in remark for remark in verdict.remarks)
    if "full queue" in kind:
        assert record["dropped_by_full_fifo"]
    if kind.startswith("spiker"):
        assert np.any(record["layers"][0]["s"])


@pytest.mark.parametrize(
    "kind",
    ["odin, recurrent", "odin, step", "odin, full queue", "odin, full queue in steps",
     "odin, spikes at the time reference", "tinyodin, recurrent", "tinyodin, full queue"],
)  # fmt: skip
def test_the_interpreter_equals_the_plain_model_with_its_queue(kind):
    record = KINDS[kind](7)
    membrane, spikes, lost = run_program(record)
    assert (membrane, spikes) == (record["v"], record["s"])
    assert lost.sum() == sum(len(neurons) for _, neurons in record["dropped_by_full_fifo"])


CHANGED = {
    "v": (lambda r: r["v"][9].__setitem__(3, 77), (9, "neurons", 3, "membrane")),
    "s": (lambda r: r["s"][9].__setitem__(3, 7), (9, "neurons", 3, "spikes")),
    "v_event": (lambda r: r["v_event"][5].__setitem__(2, -9), ("event 5", 2, "membrane")),
    "s_event": (lambda r: r["s_event"].__setitem__(0, [4]), ("event 0 (tref)", 4, "spikes")),
    "lost": (lambda r: r["dropped_by_full_fifo"].pop(0), ("event", "lost spikes")),
}


@pytest.mark.parametrize("quantity", CHANGED)
def test_a_number_that_is_not_as_recorded_is_the_first_difference(quantity, judged):
    record = KINDS["odin, full queue"](0) if quantity == "lost" else random_odin(ODIN, 1)
    change, expected = CHANGED[quantity]
    change(record)
    found = judged(record).difference
    text = f"{(found.step, found.layer, found.neuron, found.quantity)}"
    assert all(str(each) in text for each in expected)


def test_another_order_of_the_queue_is_a_difference_and_says_which_event(judged):
    record = random_odin(ODIN, 3, loop=True)
    events = record["events"]
    place = next(p for p, e in enumerate(events) if e[1] == "neuron" and events[p + 1][1] == "axon")
    events[place], events[place + 1] = events[place + 1], events[place]
    found = judged(record).difference
    assert found.quantity == "event"
    assert "neuron" in found.found
    assert "axon" in found.expected


def test_without_events_the_ends_of_timesteps_are_compared(judged):
    record = random_odin(ODIN, 4, loop=True)
    short = {k: record[k] for k in record if k not in ("events", "v_event", "s_event")}
    assert judged(short | {"dropped_by_full_fifo": None}).compared == 2 * 40 * 10
    short["v"][30][1] += 1
    assert judged(short).difference.step == 30


def broken(**fields):
    return lambda record: {**record, **fields}


def with_params(**fields):
    return lambda record: {**record, "params": {**record["params"], **fields}}


BROKEN = [
    (broken(weights=[[8] * 10] * 8), "weights holds 8"),
    (broken(weights=[[1] * 10] * 7), "weights has 7 rows"),
    (broken(weights=[1] * 10), "weights has shape"),
    (broken(index="[post][pre]"), "index is .*post"),
    (broken(weights_rec=[[1] * 9] * 9), "256 and a square"),
    (broken(input_spikes=[[-1] * 8]), "input_spikes holds -1"),
    (broken(weights=[[0] * 10] * 257, input_spikes=[[0] * 257] * 3), "257 axons"),
    *(
        (with_params(**{name: wrong}), name)
        for name, wrong in {
            "thr": [1] * 9, "leak": [128] * 10, "start": [-1] * 10, "disabled": [2] * 10,
            "host": "phone", "order": "chaos", "reset": "subtract",
        }.items()
    ),
    (with_params(thr=[256] * 10), "thr holds 256. It must be within 0 and 255"),
    (with_params(host="relays", closed_loop=True), "host relays in a closed loop"),
    (broken(v=[[0] * 10]), r"membrane has shape \(1, 10\)"),
    *((broken(s_event=wrong), "s_event") for wrong in ([[0]], [[11]])),
    (broken(v_event=[[0] * 10]), "v_event has shape"),
    (broken(events="many"), "events is 'many'. Write a list"),
    (broken(events=[]), "not divided into timesteps"),
    *(
        (broken(events=[[0, *wrong]]), "out of range")
        for wrong in (["ax", 1], ["axon", 99], ["axon", True], ["axon", [1]], [["tref"]])
    ),
    *((broken(dropped_by_full_fifo=[wrong]), "dropped_by") for wrong in ([0, [10]], 7)),
    (lambda r: {k: r[k] for k in r if k not in ("v", "s", "events", "v_event", "s_event")},
     "there is nothing to compare"),
]  # fmt: skip


@pytest.mark.parametrize(("change", "message"), BROKEN)
def test_a_file_of_odin_that_makes_no_sense_is_refused_in_a_sentence(change, message, judged):
    with pytest.raises(TraceError, match=message) as refused:
        judged(change(random_odin(ODIN, 0)))
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("name", "wrong"),
    [
        ("weights", [[16] * 7] * 8),
        ("weights", [[1] * 7] * 9),
        ("weights_rec", [[1] * 6] * 7),
        ("threshold", [1] * 6),
        ("threshold", 40000),
        ("shift", -1),
        ("neuron_bits", 64),
        ("reset", "soft"),
    ],
)
def test_a_file_of_spiker_that_makes_no_sense_is_refused_in_a_sentence(name, wrong, judged):
    record = random_spiker(0, (8, 7))
    record["layers"][0][name] = wrong
    with pytest.raises(TraceError, match=f"{name} (has|holds|is)"):
        judged(record)
