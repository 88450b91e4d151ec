"""Verifying says equal, or the first difference, or what is wrong with the file."""

import contextlib
import json
import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spikedeploy.emulation.trace_replay import replay_trace
from spikedeploy.runtime.emulator.interpreter import trace
from spikedeploy.runtime.errors import SpikedeployError, TraceError
from spikedeploy.runtime.traces import fields
from spikedeploy.runtime.traces.verify import Difference, verify
from tests.paths import GOLDEN
from tests.trace_files import recorded_trace

LAVA = GOLDEN / "lava_A_popsan_decays.json"


def small(chip, weights, inputs, expected, **params):
    """A trace of one layer whose current and membrane keep nothing, so v = u = what arrives."""
    registers = {"loihi1-brian2": (4096, 4096)}.get(chip, (4095, 4096))
    decays = {"decay_u": registers[0], "effective_decay_v": 4096}
    return {
        "source": "worked by hand",
        "chip": chip,
        "params": {"weights": weights, "vth": 131071, **decays, **params},
        **({"delay": 0} if chip == "loihi1-nengo" else {}),
        "input_spikes": inputs,
        "u": expected,
    }


@pytest.fixture
def file(tmp_path):
    def write(record, name="trace.json"):
        path = tmp_path / name
        path.write_text(record if isinstance(record, str) else json.dumps(record))
        return path

    return write


@pytest.fixture
def lava():
    return json.loads(LAVA.read_text())


# weights 7 and 7 and -7, exponent -1; the axons spike one after another, then all at once
HALVED = [[7, 7, -7]], [[1, 0, 0], [0, 0, 1], [1, 1, 1]], -1
# 2 * (255 << 13) = 4177920
LARGE = [[255, 255]], [[1, 1], [0, 0]], 7


@pytest.mark.parametrize(
    ("chip", "run", "expected"),
    [
        # each list's sum, rounded down: 7 >> 1 = 3, -7 >> 1 = -4, (14 >> 1) - 4 = 3
        ("loihi1", HALVED, [0, 3 * 64, -4 * 64]),
        # each weight, rounded down: 3, -4, 3 + 3 - 4 = 2
        ("loihi1-brian2", HALVED, [3 * 64, -4 * 64, 2 * 64]),
        # nothing is rounded: 3.5, -3.5, 3.5
        ("loihi1-nengo", HALVED, [224, -224, 224]),
        ("loihi1", LARGE, [0, 4177920]),
        ("loihi1-brian2", LARGE, [4177920, 0]),
        # in 22 bits: 4177920 - 2**22 = -16384
        ("loihi1-nengo", LARGE, [-16384, 0]),
    ],
)
def test_each_reading_rounds_negative_exponents_and_only_nengos_accumulator_overflows(
    chip, run, expected, file
):
    weights, inputs, exponent = run
    rows = [[value] for value in expected]
    path = file(small(chip, weights, inputs, rows, weight_exp=exponent))
    assert verify(path).difference is None


def test_only_sums_that_are_rounded_together_show_when_lava_rounds(file):
    # lists of their own: (14 >> 1) + (-7 >> 1) = 7 - 4 = 3; one list: (7 + 7 - 7) >> 1 = 3;
    # of 7, 6 and -6 (mixed weights are even): (7 >> 1) - 3 = 0 apart, 0 together
    rows, late = [[1, 0, 1]] * 2, [[0], [0]]
    apart = small("loihi1", [[7, 0, -5]], rows, late, weight_exp=-1)
    apart["u"][1] = [(3 - 3) * 64]
    assert verify(file(apart)).difference is None
    together = small("loihi1", [[6, 0, -4]], rows, [[0], [64]], weight_exp=-1, exc_inh_split=False)
    assert verify(file(together)).difference is None


@pytest.mark.parametrize(
    ("chip", "row", "kept"),
    [("loihi1", 1, -256), ("loihi1-brian2", 0, -254)],
)
def test_readings_disagree_about_odd_mixed_weights(chip, row, kept, file):
    expected = [[0, 0], [0, 0]]
    expected[row] = [kept * 64, 254 * 64]
    record = small(chip, [[-255], [255]], [[1], [0]], expected, exc_inh_split=False)
    assert verify(file(record)).difference is None


def test_nengos_membrane_stays_between_vmin_and_vmax(file):
    record = small("loihi1-nengo", [[5], [-5]], [[1]], [[320, -320]], vmin=0, vmax=255)
    record["v"] = [[255, 0]]
    assert verify(file(record)).difference is None


def test_a_board_shows_something_else_where_a_neuron_spikes(file):
    record = {
        "source": "a Loihi 2 board",
        "params": {"weight": 10, "vth": 9, "dv": 163},
        "input_spikes": [1, 0, 0],
        "v": [0, 128, 0],
        "s": [0.0, 1.0, 0.0],
    }
    verdict = verify(file(record))
    assert verdict.chip == "loihi2"
    assert verdict.difference is None
    assert (verdict.compared, verdict.passed_over) == (5, 1)
    record["v"] = [0, 128, 1]
    assert verify(file(record)).difference == Difference(2, "layer0", 0, "membrane", 1, 0)


BOARD = {"weight": 10, "vth": 9, "dv": 163}


@pytest.mark.parametrize(
    ("changed", "params"),
    [
        ({}, {"dv": [163], "weights": [[10]], "vth": [9]}),
        ({}, {"dv": 163.0, "w": 10, "vth_mant": 9, "w_effective": 640}),
        ({}, {"effective_decay_v": 163, "w_eff": 640, "vth_eff": 576}),
        ({}, {**BOARD, "bias": 0, "bias_mant": 0, "bias_exp": 0, "du": 4095}),
        ({"input_spikes": None, "in": [True, False, False]}, BOARD),
        ({"v": None, "s": None, "v_hw": [0, 128, 0], "s_hw": [0, 1, 0]}, BOARD),
        ({"v": None, "s": None, "probe_v": [0, 128, 0], "spikes_chip": [0, 1, 0]}, BOARD),
        ({"v": [[0, 128, 0]], "s": [[0, 1, 0]], "trace_index": "[neuron][t]"}, BOARD),
        ({"source": "Loihi2HwCfg, equal to lava's Loihi2SimCfg but where it spikes"}, BOARD),
    ],
)
def test_a_single_neuron_of_a_board_may_be_written_in_many_ways(changed, params, file):
    record = {
        "source": "a Loihi 2 board",
        "params": params,
        "input_spikes": [1, 0, 0],
        "v": [0, 128, 0],
        "s": [0, 1, 0],
    }
    verdict = verify(file(record | changed))
    assert (verdict.chip, verdict.difference, verdict.unread) == ("loihi2", None, ())
    assert (verdict.compared, verdict.passed_over) == (5, 1)


def test_only_numbers_that_were_passed_over_are_explained(lava, file):
    verdict = verify(file(lava))
    assert (verdict.passed_over, verdict.why) == (0, "")


def test_tables_may_stand_the_other_way_where_the_file_says_so(lava, file):
    turned = {name: np.transpose(lava[name]).tolist() for name in ("u", "v", "s", "input_spikes")}
    said = {"trace_index": "[post][t]", "input_spikes_index": "[pre][t]"}
    assert verify(file(lava | turned | said)).equal


def test_a_sign_mode_in_words_is_read(file):
    record = json.loads((GOLDEN / "lava_F_mixed_odd_weights.json").read_text())
    del record["params"]["exc_inh_split"]
    assert not verify(file(record)).equal
    record["params"]["sign_mode"] = "SignMode.MIXED"
    assert verify(file(record)).equal


def test_lava_takes_a_decay_that_no_register_holds_and_the_verdict_says_so(file):
    record = small("loihi1", [[3]], [[1], [0], [1]], [[0], [192], [0]])
    record["v"] = record["u"]
    params = record["params"]
    del params["effective_decay_v"]
    verdict = verify(file({**record, "params": {**params, "dv": 4096}}))
    assert verdict.equal
    (remark,) = verdict.remarks
    assert remark.startswith("layer0: dv is 4096, which lava takes and the chip's register of 12")
    assert verify(file(small("loihi1", [[3]], [[1]], [[0]]))).remarks == ()
    other = {**record, "chip": "loihi1-nengo", "params": {**params, "dv": 4096}}
    with pytest.raises(TraceError, match="dv holds 4096"):
        verify(file(other))


def test_a_bias_that_is_given_twice_must_be_the_same(lava, file):
    # 3 * 2^4
    params = {**lava["params"], "bias_mant": 3, "bias_exp": 4, "bias": 50}
    with pytest.raises(TraceError, match=r"bias is not bias_mant times 2.bias_exp"):
        verify(file({**lava, "params": params}))


@pytest.mark.parametrize(("quantity", "key"), [("current", "u"), ("membrane", "v")])
def test_the_first_difference_is_told(quantity, key, lava, file):
    lava[key][30][1] += 1
    lava[key][17][2] -= 64
    found = lava[key][17][2] + 64
    difference = Difference(17, "layer0", 2, quantity, found - 64, found)
    assert verify(file(lava)).difference == difference


def test_within_a_step_the_current_comes_before_what_follows_from_it(lava, file):
    lava["s"][20][0] ^= 1
    lava["v"][20][1] += 1
    lava["u"][20][3] += 1
    found = verify(file(lava)).difference
    assert (found.quantity, found.neuron) == ("current", 3)


def test_a_difference_in_a_hidden_layer_names_it(file):
    record = json.loads((GOLDEN / "lava_L_chain_3layers.json").read_text())
    record["layers"][1]["s"][9][4] ^= 1
    found = verify(file(record)).difference
    assert (found.layer, found.step, found.neuron, found.quantity) == ("layer1", 9, 4, "spikes")


def test_a_trace_need_not_hold_everything(lava, file):
    del lava["u"], lava["v"]
    assert verify(file(lava)).compared == 200


def test_fields_without_a_meaning_are_told(lava, file):
    lava["params"]["stochastic"] = 3
    assert verify(file(lava)).unread == ("stochastic",)


def test_the_name_of_the_file_helps_where_its_source_does_not(lava, file):
    lava["source"] = lava["kind"] = ""
    assert verify(file(lava, "lava_of_my_own.json")).chip == "loihi1"


def test_parameters_may_differ_from_neuron_to_neuron(file):
    record = small("loihi1", [[9], [9]], [[1], [0]], [[0, 0], [576, 576]], vth=[8, 9])
    record["s"] = [[0, 0], [1, 0]]
    record["params"]["vth"] = [8, 9]
    assert verify(file(record)).difference is None


def broken(key, value):
    return lambda record: record["params"].__setitem__(key, value)


def top(key, value):
    return lambda record: record.__setitem__(key, value)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (top("source", "a chip"), "no emulator or chip is known"),
        (top("chip", "loihi9"), "chip 'loihi9' is not known"),
        (top("chip", "ideal"), "can be run but has no trace format"),
        (top("params", 3), "params: expected an object"),
        (top("input_spikes", [[2] * 12] * 50), "input_spikes holds 2"),
        (top("input_spikes", [[1] * 12] * 49), r"shape \(50, 4\).*\(49, 4\)"),
        (top("input_spikes", 1), "single number"),
        (top("input_spikes", []), "input_spikes holds"),
        (top("u", [[0.5] * 4] * 50), "whole numbers"),
        (top("u", [[float("nan")] * 4] * 50), "whole numbers"),
        (top("u", [[1 << 80] * 4] * 50), "whole numbers"),
        (top("v", [["1"] * 4] * 50), "whole numbers"),
        (top("s", [[[1]]]), "2 deep at most"),
        (top("layers", []), "list of objects"),
        (top("layers", [3]), r"layers\[0\]: expected an object"),
        (broken("weights", [[1, 2], [3]]), "different lengths"),
        (broken("weights", [[1, 2, 3]]), "12 weights"),
        (broken("weights", None), "weights is missing"),
        (broken("weights", [[300] * 12]), "weights holds 300"),
        (broken("du", 5000), "du holds 5000"),
        (top("params", {"weights": [[1] * 12] * 4, "vth": 1}), "dv or decay_v is missing"),
        (broken("vth", [1, 2]), "vth has 2 values"),
        (broken("vth", -1), "vth holds -1"),
        (broken("num_weight_bits", 7), "weight_bits is 7"),
        (broken("weight_exp", 99), "weight_exp holds 99"),
        (broken("delay", 10**9), "delay holds 1000000000"),
        (broken("exc_inh_split", "yes"), "exc_inh_split is 'yes'"),
    ],
)
def test_a_broken_file_is_told_what_is_wrong(change, message, lava, file):
    change(lava)
    with pytest.raises(Exception, match=message) as caught:
        verify(file(lava))
    assert type(caught.value).__name__ in ("TraceError", "ChipError")


@pytest.mark.parametrize("text", ["", "{", "[1]", "3", "null", "[" * 100_000, '"u"', "\x00"])
def test_a_file_that_is_no_trace_at_all_is_refused(text, file):
    with pytest.raises(TraceError):
        verify(file(text))


def test_a_trace_without_recordings_is_refused(lava, file):
    del lava["u"], lava["v"], lava["s"]
    with pytest.raises(TraceError, match="nothing to compare"):
        verify(file(lava))


@pytest.fixture
def sanafe():
    return json.loads((GOLDEN / "sanafe_loihi_energy_example.json").read_text())


def test_the_energy_of_sanafe_is_verified(sanafe, file):
    verdict = verify(file(sanafe))
    assert verdict.difference is None
    assert (verdict.compared, verdict.passed_over) == (9, 1)
    sanafe["setup"] = sanafe["setup"].replace("10 input", "20 input")
    found = verify(file(sanafe)).difference
    assert (found.step, found.quantity, found.expected, found.found) == (
        None, "spikes(synops)", 300, 600,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (top("setup", "a network"), "cannot be read"),
        (top("result", {}), "nothing to compare"),
        (top("result", {"energy": {"total": "much"}}), "total is 'much'"),
        (top("result", {"energy": {"total": float("inf")}}), "finite"),
    ],
)
def test_a_broken_energy_file_is_told_what_is_wrong(change, message, sanafe, file):
    change(sanafe)
    with pytest.raises(TraceError, match=message):
        verify(file(sanafe))


JUNK = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**70), 2**70) | st.floats() | st.text(max_size=3),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=3), inner),
    max_leaves=5,
)


@settings(max_examples=300, deadline=None)
@given(st.sampled_from(sorted(GOLDEN.glob("*.json"))), st.randoms(use_true_random=False), JUNK)
def test_junk_in_a_field_is_an_error_or_a_verdict_and_never_a_crash(
    tmp_path_factory, source, rng, junk
):
    record = json.loads(source.read_text())
    groups = [record, *(record[name] for name in ("params", "result") if name in record)]
    group = rng.choice([*groups, *record.get("layers", [])])
    group[rng.choice(sorted(group))] = junk
    path = tmp_path_factory.getbasetemp() / "junk.json"
    path.write_text(json.dumps(record))
    with contextlib.suppress(SpikedeployError):
        assert verify(path).compared > 0


def test_a_program_of_a_trace_runs_like_any_other():
    recorded = recorded_trace(LAVA)
    ran = trace(recorded.program, np.repeat(recorded.raster, 2, axis=0))
    np.testing.assert_array_equal(ran["layer0"].spikes[0], ran["layer0"].spikes[1])


@pytest.mark.parametrize("value", [["a" * 10_000, ""], [[1, "2"]], [None], [{}], "1"])
def test_an_array_of_anything_but_numbers_never_becomes_one(value, lava, file, monkeypatch):
    path = file({**lava, "input_spikes": value})
    monkeypatch.setattr(fields.np, "array", lambda *_: pytest.fail("np.array was asked"))
    with pytest.raises(TraceError, match=r"input_spikes (holds|is missing)"):
        verify(path)


@pytest.mark.parametrize("limit", ["TICKS", "STATES", "NEURONS", "PRODUCTS"])
@pytest.mark.parametrize(
    "trace", ["lava_L_chain_3layers", "xylo_own_aliases", "rtl/spiker_subtract"]
)
def test_a_replay_that_would_take_too_long_is_refused(limit, trace, monkeypatch):
    monkeypatch.setattr(fields, f"_MOST_{limit}", 3)
    with pytest.raises(TraceError, match=r"replay has .* At most 3 are replayed"):
        verify(GOLDEN / f"{trace}.json")


@pytest.mark.parametrize("trace", ["xylo_own_aliases", "rtl/spiker_subtract"])
def test_what_is_taken_one_by_one_is_part_of_the_work(trace, monkeypatch):
    monkeypatch.setattr(fields, "_MOST_ONE_BY_ONE", 3)
    with pytest.raises(TraceError, match="axons and aliases"):
        verify(GOLDEN / f"{trace}.json")


def test_hidden_neurons_of_xylo_are_one_layer_with_their_recurrent_synapses(monkeypatch):
    path = GOLDEN / "xylo_B_two_syn_bias_rec.json"
    most = 2 * verify(path).steps
    monkeypatch.setattr(fields, "_MOST_TICKS", most)
    assert verify(path).equal
    monkeypatch.setattr(fields, "_MOST_TICKS", most - 1)
    with pytest.raises(TraceError, match=f"has {most} layers times timesteps"):
        verify(path)


def test_layers_and_fields_and_numbers_are_limited(lava, file, monkeypatch):
    with pytest.raises(TraceError, match="layers has 257"):
        verify(file({**lava, "layers": [{}] * 257}))
    with pytest.raises(TraceError, match=r"there are 1.* fields"):
        verify(file(lava | {f"f{n}": 1 for n in range(1000)}))
    monkeypatch.setattr(fields, "_MOST_READ", 1000)
    with pytest.raises(TraceError, match=r"makes .* numbers in all layers"):
        verify(GOLDEN / "lava_L_chain_3layers.json")


def test_a_long_source_is_read_in_no_time(lava, file):
    start = time.process_time()
    with pytest.raises(TraceError, match="no emulator or chip is known"):
        verify(file({**lava, "source": "hw_loihi" * 200_000, "name": "", "kind": ""}))
    assert time.process_time() - start < 2


def test_nothing_in_a_file_reaches_the_terminal_as_a_command(lava, file):
    names = {f"\x1b[31mq{n}\nline{'x' * 100}": 1 for n in range(9)}
    replay = replay_trace(file({**lava, **names, "source": "lava \x1b]0;title\x07" + "A" * 9999}))
    printed = " ".join([replay.describe(), *replay.remarks()])
    assert printed.isprintable()
    assert "\\x1b]0;title" in printed
    assert "and 4 more" in printed
    assert len(printed) < 1000
    refused = replay_trace(file({"chip": "\x1b[31m\ud800" * 999})).describe()
    assert refused.isprintable()
    assert len(refused) < 500
