"""`spikedeploy emulate`: every primitive, any shape, several inputs and outputs, from files."""

import json

import nir
import numpy as np
import pytest

from tests.networks import chain, graph, lif


def full(*values):
    return [np.full(1, value) for value in values]


def ones(*shape):
    return np.ones(shape)


TWO = np.array([2, 2])
ROWS = [[[1.0]], [[2.0]]]
TEN = np.array([[[1.0, 10.0]]])
# node, what comes in (T, *shape), what comes out; at dt = 1 ms
CASES = {
    "Affine": (nir.Affine(np.diag([2.0, 3.0]), np.array([1.0, 0.0])), [[1, 2]], [[3, 6]]),
    "Linear": (nir.Linear(np.diag([2.0, 3.0])), [[1, 2]], [[2, 6]]),
    "Scale": (nir.Scale(np.array([2.0, 3.0])), [[1, 2]], [[2, 6]]),
    "Conv1d": (nir.Conv1d(3, TEN, 1, 0, 1, 1, full(0.5)[0]), [[[1, 2, 3]]], [[[21.5, 32.5]]]),
    "Conv2d": (
        nir.Conv2d((1, 3), TEN[None], 1, 0, 1, 1, full(0.5)[0]),
        [[[[1, 2, 3]]]],
        [[[[21.5, 32.5]]]],
    ),
    "Flatten": (nir.Flatten({"input": np.array([1, 2])}, 0, -1), [[[1, 2]]], [[1, 2]]),
    "SumPool2d": (nir.SumPool2d(TWO, TWO, 0 * TWO), [[[[1, 2], [3, 4]]]], [[[[10]]]]),
    "AvgPool2d": (nir.AvgPool2d(TWO, TWO, 0 * TWO), [[[[1, 2], [3, 4]]]], [[[[2.5]]]]),
    "Delay": (nir.Delay(full(1e-3)[0]), [[1], [2]], [[0], [1]]),
    "Threshold": (nir.Threshold(np.array([1.5])), [[1], [2]], [[0], [1]]),
    # 1 + 2
    "I": (nir.I(*full(1000.0)), [[1], [2]], [[1], [3]]),
    "IF": (nir.IF(*full(1000.0, 2.5, 0.0)), [[1], [2]], [[0], [1]]),
    # 3/4 of 1, and 1 more
    "LI": (nir.LI(*full(4e-3, 4.0, 0.0)), [[1], [1]], [[1], [1.75]]),
    "LIF": (nir.LIF(*full(4e-3, 4.0, 0.0, 1.5, 0.0)), [[1], [1]], [[0], [1]]),
    # currents 1 and 1.5, membranes 1 and 0.75 + 1.5
    "CubaLI": (nir.CubaLI(*full(2e-3, 4e-3, 4.0, 0.0), *full(2.0)), [[1], [1]], [[1], [2.25]]),
    "CubaLIF": (
        nir.CubaLIF(*full(2e-3, 4e-3, 4.0, 0.0, 2.0, 0.0), *full(2.0)), [[1], [1]], [[0], [1]],
    ),
}  # fmt: skip


@pytest.fixture
def emulate(command, tmp_path):
    """Write a graph and its rasters, run `emulate` on them: exit code, arrays, stdout, stderr."""

    def run(network, rasters, *words):
        nir.write(tmp_path / "a.nir", network)
        if isinstance(rasters, dict):
            np.savez(tmp_path / "in.npz", **rasters)
        else:
            np.save(tmp_path / "in.npy", rasters)
        given = tmp_path / ("in.npz" if isinstance(rasters, dict) else "in.npy")
        files = ("--input", given, "-o", tmp_path / "out.npz")
        code, out, err = command("emulate", tmp_path / "a.nir", *files, *words)
        if code:
            return code, {}, out, err
        with np.load(tmp_path / "out.npz") as arrays:
            return code, dict(arrays), out, err

    return run


def test_what_was_computed_is_printed_first_and_neurobench_on_demand(emulate):
    network = chain(nir.Linear(np.eye(2)), lif(2, threshold=1.0), width=2, act=2)
    raster, words = np.ones((40, 2), np.uint8), ("--chip", "loihi1", "--dt", 1e-3)
    _, arrays, out, _ = emulate(network, raster, *words)
    first, spikes, sops = out.splitlines()[3:6]
    sums = arrays["output"].sum(axis=0)
    assert first.split()[:3] == ["sums", "of", "outputs"]
    assert ", ".join(f"{each:,.6g}" for each in sums) in first
    assert (spikes.split(), sops.split()) == (["spikes", f"{sums.sum():.0f}"], ["SOPs", "80"])
    assert "NeuroBench's measures: --tables all" in out
    assert "MembraneUpdates" not in out
    assert "MembraneUpdates" in emulate(network, raster, *words, "--tables", "all")[2]


@pytest.mark.parametrize(("threshold", "silent"), [(1.0, False), (20.0, True)])
def test_a_network_that_never_spikes_is_said_to_be_silent(
    threshold, silent, emulate, command, tmp_path
):
    network = chain(nir.Linear(np.eye(1)), lif(1, threshold=threshold), width=1, act=1)
    words = ("--dt", 1e-3)
    code, _, out, _ = emulate(network, np.ones((40, 1), np.uint8), "--chip", "loihi1", *words)
    assert (code, "no neuron spikes" in out) == (0, silent)
    files = (tmp_path / "a.nir", "--input", tmp_path / "in.npy", "--chip", "loihi1")
    code, out, _ = command("drift", *files, *words)
    assert (code, "no neuron spikes" in out) == (0, silent)


def test_what_runs_beyond_the_limits_of_a_chip_says_so(emulate):
    # Xylo has 16 inputs
    cells = lif(1, tau=2e-3, r=2.0)
    wide, on = nir.Linear(np.ones((1, 17))), nir.Linear(np.ones((1, 1)))
    network = chain(wide, cells, on, cells, width=17, act=1)
    words = ("--chip", "xylo-a2", "--reset", "subtract")
    code, _, _, err = emulate(network, np.ones((3, 17), np.uint8), *words)
    assert code == 1
    assert "rule inputs" in err
    code, _, out, _ = emulate(network, np.ones((3, 17), np.uint8), *words, "--limits", "off")
    assert code == 0
    assert "limits off: `spikedeploy check` says" in out


@pytest.mark.parametrize(
    ("chip", "reset", "spikes", "several"),
    [
        ("odin", "zero", "above", "2 times in 'n2'"),
        ("odin:queue=on", "zero", "above", "2 times in 'n2'"),
        ("tinyodin", "zero", "above", "2 times in 'n2'"),
        ("odin", "zero", "many", ""),  # as the file says
        ("speck2f", "subtract", "above", "2 times in 'n2'"),
        ("speck2f", "zero", "above", ""),
        ("loihi1", "zero", "above", ""),
        ("float", "subtract", "many", ""),
    ],
)
def test_several_spikes_in_a_timestep_where_the_file_means_one_are_said(
    chip, reset, spikes, several, emulate
):
    # each of two inputs is above the threshold by itself
    neuron = nir.IF(np.full(1, 1000.0), np.full(1, 0.9), np.zeros(1))
    network = chain(nir.Linear(np.ones((1, 2))), neuron, width=2, act=1)
    rows = np.array([[1, 1], [0, 1], [1, 1]], np.uint8)
    words = ("--dt", 1e-3, "--reset", reset, "--spikes", spikes, "--chip", chip)
    code, arrays, out, err = emulate(network, rows, *words)
    assert not code, err
    assert ("several spikes in one timestep" in out, several in out) == (bool(several), True)
    if several:
        assert (arrays["n2"] > 1).sum() == 2


@pytest.mark.parametrize(("chip", "said"), [("speck2f", True), ("speck2f:queue=on", False)])
def test_speck_in_timesteps_says_that_the_chip_goes_event_by_event(chip, said, emulate, command):
    file = "tests/golden/exports/sinabs_conv.nir"
    _, checked, _ = command("check", file, "--from", "sinabs", "--chip", chip)
    network = chain(nir.Linear(np.ones((1, 2))), nir.IF(*full(1e3, 2.5, 0.0)), width=2, act=1)
    words = ("--dt", 1e-3, "--reset", "subtract", "--chip", chip)
    _, _, ran, _ = emulate(network, np.ones((3, 2), np.uint8), *words)
    for out in (checked, ran):
        assert ("queue=on, and --step event" in " ".join(out.split())) == said


@pytest.mark.parametrize("kind", CASES)
def test_each_primitive_computes_what_nir_says(kind, emulate):
    node, x, wanted = CASES[kind]
    x, wanted = np.array(x, float), np.array(wanted, float)
    ends = {
        "input": nir.Input(np.array(x.shape[1:])),
        "output": nir.Output(np.array(wanted.shape[1:])),
    }
    network = nir.NIRGraph({**ends, "n": node}, [("input", "n"), ("n", "output")], type_check=False)
    words = ("--chip", "float", "--dt", 0.001, "--delay", 0, "--json")
    code, arrays, _, err = emulate(network, x, *words)
    assert not code, err
    np.testing.assert_allclose(arrays["output"], wanted, atol=1e-12)


def two_ways():
    """a into one neuron, b into another, and both are outputs."""
    edges = "a->la, b->lb, la->oa, lb->ob"
    inputs = {"a": nir.Input(np.array([1])), "b": nir.Input(np.array([1]))}
    outputs = {"oa": nir.Output(np.array([1])), "ob": nir.Output(np.array([1]))}
    return graph(edges, **inputs, **outputs, la=lif(1, 4e-3, 4.0, 0.5), lb=lif(1, 4e-3, 4.0, 0.5))


@pytest.mark.parametrize("chip", ["float", "ideal", "loihi1"])
def test_several_inputs_and_outputs_go_by_their_names(chip, emulate):
    rasters = {"a": np.array([[1], [0]]), "b": np.array([[0], [1]])}
    code, arrays, out, err = emulate(two_ways(), rasters, "--chip", chip, "--json")
    assert not code, err
    assert {name: rows.ravel().tolist() for name, rows in arrays.items()} == {
        "la": [1, 0], "lb": [0, 1], "oa": [1, 0], "ob": [0, 1],
    }  # fmt: skip
    assert json.loads(out)["outputs"] == {"oa": [1], "ob": [1]}


def test_a_raster_without_a_name_does_not_fit_several_inputs(emulate):
    code, _, _, err = emulate(two_ways(), np.ones((3, 1)), "--chip", "float")
    assert code == 2
    assert "one raster without a name" in err


def single(threshold=1.0):
    return graph(
        "input->n, n->output",
        input=nir.Input(np.array([1])),
        output=nir.Output(np.array([1])),
        n=lif(1, 4e-3, 4.0, threshold),
    )


def test_float_takes_real_numbers_and_a_chip_refuses_them(emulate):
    x = np.array([[2.5], [-1.0]])
    code, arrays, out, _ = emulate(single(), x, "--chip", "float")
    assert not code
    assert arrays["n"].tolist() == [[1], [0]]
    assert "not counted" in out
    code, _, _, err = emulate(single(), x, "--chip", "loihi1")
    assert code == 2
    assert "a chip takes spikes" in err


def test_options_say_how_many_spikes_and_where_the_floor_is(emulate):
    words = ("--chip", "float", "--reset", "subtract")
    x = np.array([[3.0], [-9.0], [2.0]])
    # 3 thresholds at once, then -9, and -6.75 + 2
    assert emulate(single(), x, *words, "--spikes", "many")[1]["n"].tolist() == [[3], [0], [0]]
    # one of them leaves 2, then -7.5, which the floor lifts to 0, and 2
    found = emulate(single(), x, *words, "--floor", "zero", "--state", "kept")
    assert found[1]["n"].tolist() == [[1], [0], [1]]
    assert "floor=zero" in found[2]
    # 1 is at the threshold, not above it
    one = np.array([[1.0]])
    assert emulate(single(), one, "--chip", "float")[1]["n"].tolist() == [[0]]
    reached = emulate(single(), one, "--chip", "float", "--spikes", "reached")
    assert reached[1]["n"].tolist() == [[1]]


def test_a_backend_is_for_chips(emulate):
    raster = np.ones((3, 1))
    assert emulate(single(), raster, "--chip", "loihi1", "--backend", "numpy")[0] == 0
    for chip, backend, message in (
        ("float", "numpy", "--backend numpy is for programs of a chip"),
        ("loihi1", "abacus", "backend 'abacus' is unknown"),
    ):
        code, _, _, err = emulate(single(), raster, "--chip", chip, "--backend", backend)
        assert code == 2
        assert message in err


@pytest.mark.parametrize("chip", ["float", "ideal"])
def test_a_raster_that_would_fill_the_memory_is_refused(chip, emulate, monkeypatch):
    monkeypatch.setattr("spikedeploy.emulation.raster_emulation.LARGEST", 1000)
    monkeypatch.setattr("spikedeploy.runtime.float_model.MAX_RUN_BYTES", 1000)
    assert emulate(single(), np.ones((5, 1)), "--chip", chip)[0] == 0
    code, _, _, err = emulate(single(), np.ones((50, 1)), "--chip", chip)
    assert code == 2
    assert "50 timesteps" in err
    assert "at most 1000" in err


@pytest.mark.parametrize("name", ["file", "arr_0", "a b", "[red]", "..", "ü"])
def test_a_node_may_have_any_name(name, emulate):
    ends = {"input": nir.Input(np.array([1])), "end": nir.Output(np.array([1]))}
    nodes = {name: lif(1, 4e-3, 4.0, 0.5), **ends}
    network = nir.NIRGraph(nodes, [("input", name), (name, "end")])
    code, arrays, out, err = emulate(network, np.ones((1, 1)), "--chip", "loihi1")
    assert not code, err
    assert arrays[name].tolist() == [[1]]
    assert name in out
