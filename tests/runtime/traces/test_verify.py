"""Verifying says equal, or the first difference, or what is wrong with the file."""

import contextlib
import json

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spikedeploy.emulation.verification import replay_trace
from spikedeploy.runtime.errors import SpikedeployError, TraceError
from spikedeploy.runtime.traces import fields, verdict
from spikedeploy.runtime.traces.verdict import TraceDifference
from spikedeploy.runtime.traces.verify import verify
from tests.paths import GOLDEN

LAVA = GOLDEN / "lava_A_popsan_decays.json"


def small(chip, weights, inputs, expected, **params):
    """A trace of one layer whose current and membrane keep nothing, so v = u = what arrives."""
    registers = {"loihi1-brian2": (4096, 4096)}.get(chip, (4095, 4096))
    decays = {"decay_u": registers[0], "decay_v": 4095}
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


BOARD = {"weights": 10, "vth": 9, "dv": 163}


@pytest.mark.parametrize(
    ("changed", "params"),
    [
        ({}, {"dv": [163], "weights": [[10]], "vth": [9]}),
        ({}, {"decay_v": 163.0, "weights": [[10]], "vth_effective": 576}),
        ({}, {**BOARD, "bias": 0, "bias_mant": 0, "bias_exp": 0, "du": 4095}),
        ({"input_spikes": [True, False, False]}, BOARD),
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
    found = verify(file(record | changed))
    assert (found.chip, found.difference, found.unread) == ("loihi2", None, ())
    assert (found.compared, found.passed_over) == (5, 1)


def test_lava_takes_a_decay_that_no_register_holds_and_the_verdict_says_so(file):
    record = small("loihi1", [[3]], [[1], [0], [1]], [[0], [192], [0]])
    record["v"] = record["u"]
    params = record["params"]
    found = verify(file({**record, "params": {**params, "dv": 4096}}))
    assert found.equal
    assumed, remark = found.remarks
    assert assumed.startswith("layer0: not in the file, so taken as loihi1 has it: ")
    assert remark.startswith("layer0: dv is 4096, which lava takes and the chip's register of 12")
    other = {**record, "chip": "loihi1-nengo", "params": {**params, "dv": 4096}}
    with pytest.raises(TraceError, match="decay_v holds 4096"):
        verify(file(other))


TAKEN = {
    "chain": "exc_inh_split true, weight_exp 0, num_weight_bits 8, refractory 1, vmin and vmax of "
    "its register, delay 1 from {}, bias 0",
    "brian2": "vmin and vmax of its register, delay 0 from the input, bias 0",
}


@pytest.mark.parametrize(
    ("name", "removed", "said"),
    [
        ("lava_L_chain_3layers", (), [
            f"layer0: {{}}{TAKEN['chain'].format('the input')}",
            f"layer1, layer2: {{}}{TAKEN['chain'].format('layers')}",
        ]),
        ("brian2loihi_own_exponent", (), [f"layer0: {{}}{TAKEN['brian2']}"]),
        ("brian2loihi_own_exponent", ("weight_exp",),
         [f"layer0: {{}}weight_exp 0, {TAKEN['brian2']}"]),
        ("nengoloihi_own_vmin", ("decay_u", "effective_decay_u"),
         ["layer0: {}exc_inh_split true, num_weight_bits 8, decay_u 4095"]),
        ("xylo_own_saturation", ("weight_shift", "bias", "dash_syn_2"),
         ["hidden: {}weight_shift 0, aliases none, dash_syn_2 0, bias 0",
          "output: {}weight_shift 0"]),
        ("rtl/odin_random", ("leak", "closed_loop", "host"),
         ["neurons: {}host wait, weights_rec none, closed_loop false, leak 0"]),
        ("rtl/spiker_fixed_reset", ("v_reset", "weight_bits", "reset"),
         ["layer0: {}weight_bits 5, reset subtract, weights_rec none, v_reset 0"]),
    ],
)  # fmt: skip
def test_what_is_taken_for_missing_fields_is_said(name, removed, said, file):
    record = json.loads((GOLDEN / f"{name}.json").read_text())
    for group in (record, record.get("params", {})):
        for each in removed:
            group.pop(each, None)
    found = verify(file(record))
    chip = f"not in the file, so taken as {found.chip} has it: "
    assert [r for r in found.remarks if chip in r] == [each.format(chip) for each in said]


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
    difference = TraceDifference(17, "layer0", 2, quantity, found - 64, found)
    assert verify(file(lava)).difference == difference


def test_fields_without_a_meaning_are_told(lava, file):
    lava["params"]["stochastic"] = 3
    assert verify(file(lava)).unread == ("stochastic",)


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
        (lambda record: record.update(u=None, v=None, s=None), "nothing to compare"),
        (top("params", 3), "params: expected an object"),
        *((top("input_spikes", wrong), "input_spikes") for wrong in ([[2] * 12] * 50, 1, [])),
        (top("input_spikes", [[1] * 12] * 49), r"shape \(50, 4\).*\(49, 4\)"),
        *(
            (top("u", [[wrong] * 4] * 50), "current holds")
            for wrong in (0.5, float("nan"), 1 << 80, "1")
        ),
        (top("s", [[[1]]]), "2 deep at most"),
        (top("layers", []), "layers has 0"),
        (top("layers", [3]), r"layers\[0\]: expected an object"),
        (broken("weights", [[1, 2], [3]]), "different lengths"),
        (broken("weights", [[1, 2, 3]]), "12 weights"),
        (broken("weights", None), "weights is missing"),
        (broken("weights", [[300] * 12]), "weights holds 300"),
        (broken("du", 5000), "decay_u holds 5000"),
        (top("params", {"weights": [[1] * 12] * 4, "vth": 1}), "decay_v is missing"),
        (broken("vth", [1, 2]), "vth has 2 values"),
        (broken("vth", -1), "vth holds -1"),
        (broken("num_weight_bits", 7), "weight_bits is 7"),
        (broken("weight_exp", 99), "weight_exp holds 99"),
        (broken("delay", 10**9), "delay holds 1000000000"),
        (broken("exc_inh_split", "yes"), "exc_inh_split is 'yes'"),
        *((broken("delays", wrong), "delays") for wrong in ([[1, 2]], [[64] * 12] * 4)),
        (broken("weights_input", [[1] * 12] * 4), "weights_input has shape"),
        (broken("index", "[pre][post]"), "index is '.pre..post.'"),
        (top("trace_index", "[neuron][t]"), "trace_index is '.neuron..t.'"),
        (top("input_spikes_index", "[pre][t]"), "input_spikes_index is '.pre..t.'"),
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


@pytest.fixture
def sanafe():
    return json.loads((GOLDEN / "sanafe_loihi_energy_example.json").read_text())


def test_the_energy_of_sanafe_is_verified(sanafe, file):
    found = verify(file(sanafe))
    assert found.difference is None
    assert (found.compared, found.passed_over) == (9, 1)
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


SOURCES = [*sorted(GOLDEN.glob("*.json")), *(GOLDEN / "rtl").glob("odin_random*.json"),
           *(GOLDEN / "rtl").glob("spiker*.json")]  # fmt: skip


@settings(max_examples=10)
@given(st.sampled_from(SOURCES), st.randoms(use_true_random=False), JUNK)
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


@pytest.mark.parametrize("value", [["a" * 10_000, ""], [[1, "2"]], [None], [{}], "1"])
def test_an_array_of_anything_but_numbers_never_becomes_one(value, lava, file, monkeypatch):
    path = file({**lava, "input_spikes": value})
    monkeypatch.setattr(fields.np, "array", lambda *_: pytest.fail("np.array was asked"))
    with pytest.raises(TraceError, match=r"input_spikes (holds|is missing)"):
        verify(path)


@pytest.mark.parametrize(
    "trace", ["lava_L_chain_3layers", "xylo_own_aliases", "rtl/spiker_subtract"]
)
def test_a_replay_that_would_take_too_long_is_refused(trace, monkeypatch):
    monkeypatch.setattr(verdict, "MOST_WORK", 3)
    with pytest.raises(TraceError, match="replay has"):
        verify(GOLDEN / f"{trace}.json")


def test_layers_are_limited(lava, file):
    with pytest.raises(TraceError, match="layers has 257"):
        verify(file({**lava, "layers": [{}] * 257}))


def test_nothing_in_a_file_reaches_the_terminal_as_a_command(lava, file):
    names = {f"\x1b[31mq{n}\nline{'x' * 100}": 1 for n in range(9)}
    replay = replay_trace(file({**lava, **names, "source": "lava \x1b]0;title\x07" + "A" * 9999}))
    printed = " ".join(replay.lines)
    assert printed.isprintable()
    assert "\\x1b]0;title" in printed
    assert "and 4 more" in printed
    assert len(printed) < 1000
    (refused,) = replay_trace(file({"chip": "\x1b[31m\ud800" * 999})).lines
    assert refused.isprintable()
    assert len(refused) < 500
