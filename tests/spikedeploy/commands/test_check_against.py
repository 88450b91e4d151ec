"""`check --against`: the float twin and what the author's framework recorded."""

import inspect
import json
import runpy
import sys
from functools import partial

import nir
import numpy as np
import pytest
from typer.testing import CliRunner

from spikedeploy.cli import app
from spikedeploy.emulation.framework_recordings import (
    CHOICES,
    find_cause,
    find_difference,
    read_recorded,
)
from spikedeploy.evaluation_setup import Reading
from spikedeploy.runtime.artifact.artifact import load
from spikedeploy.runtime.float_model import FloatGraph
from tests.networks import chain, cuba, lif
from tests.paths import ROOT

EXPORTS = ROOT / "tests/golden/exports"
LEAKY = EXPORTS / "snntorch_leaky.nir"


def check(*words):
    return CliRunner().invoke(app, ["check", *map(str, words)], env={"COLUMNS": "200"})


def against(network, recording, *words):
    return check(EXPORTS / f"{network}.nir", "--against", EXPORTS / f"{recording}.npz", *words)


def test_an_equal_recording_is_said_to_be_equal():
    found = against("snntorch_leaky", "snntorch_leaky_default", "--from", "snntorch")
    assert found.exit_code == 0
    assert "your framework = our float: equal, 1,200 outputs, 332 spikes" in found.stdout
    assert "assumed: reset by subtraction, delayed" in found.stdout


def test_a_recording_of_silence_proves_nothing(tmp_path):
    nir.write(tmp_path / "a.nir", chain(lif(3), width=3, act=3))
    rows = np.zeros((40, 3))
    for inputs, said in (
        (0, "all 120 outputs are 0, and ours are"),
        (1e9, "your framework 0, our"),
    ):
        np.savez(tmp_path / "a.npz", input=rows + inputs, output=rows)
        found = check(tmp_path / "a.nir", "--dt", 1e-3, "--against", tmp_path / "a.npz")
        assert found.exit_code == 1  # the runner's, of any exception
        assert said in f"{found.stdout}{found.exception}"


@pytest.mark.parametrize(
    ("network", "recording", "words", "cause"),
    [
        ("snntorch_leaky", "snntorch_leaky_default", [], "--reset subtract-delayed"),
        ("snntorch_leaky", "snntorch_leaky_zero", ["--from", "snntorch"], "--reset zero"),
        ("snntorch_leaky", "snntorch_leaky_subtract", ["--from", "snntorch"], "--reset subtract"),
        ("snntorch_leaky", "snntorch_leaky_zero", ["--delay", "1"], "--delay 0"),
        ("norse_lifboxcell", "norse_lifboxcell", ["--from=norse", "--dt=2e-3"], "--dt 0.001"),
        ("spikingjelly_lif_slow", "spikingjelly_lif_slow", [], "--from spikingjelly"),
    ],
)
def test_the_likeliest_cause_is_named(network, recording, words, cause):
    found = against(network, recording, *words)
    assert found.exit_code == 1
    assert "your framework ≠ our float: inference 0, timestep " in found.stdout
    assert f"likeliest cause: {cause}" in found.stdout


def test_the_search_has_every_option_that_check_has():
    typed = {"written_by" if name == "from_" else name for name in vars(Reading())}
    assert set(CHOICES) == typed == set(inspect.signature(load).parameters) - {"path"}


def recording(path, tmp_path, **options):
    """A recording of two inferences of the file, as it is with these options; its path."""
    rng = np.random.default_rng(1)
    artifact = load(path, **options)
    (node,) = artifact.graph.inputs.values()
    inputs = (rng.random((2, 40, *node.output_type["output"])) < 0.4).astype(float)
    rows = inputs.reshape(1, 80, -1) if options.get("state") == "kept" else inputs
    outputs = FloatGraph(artifact).run(rows)["output"].reshape(2, 40, -1)
    np.savez(tmp_path / "a.npz", input=inputs, output=outputs)
    return tmp_path / "a.npz"


def network(tmp_path, *nodes):
    """The path of a file with two layers of these neurons behind seeded weights."""
    rng = np.random.default_rng(2)
    first, second = nodes
    weights = [nir.Affine(rng.normal(size=size), np.zeros(size[0])) for size in ((10, 8), (4, 10))]
    layers = weights[0], first, weights[1], second
    nir.write(tmp_path / "a.nir", chain(*layers, width=8, act=4))
    return tmp_path / "a.nir"


def nir_if(r, size):
    return nir.IF(np.full(size, r), np.ones(size))


@pytest.mark.parametrize(
    ("option", "choice", "cause"),
    [
        ("reset", "subtract", "--reset subtract"),
        ("delay", 1, "--delay 1"),
        ("dt", 1e-4, "--dt 0.0001"),
        ("spikes", "many", "--spikes many"),
        ("floor", "zero", "--floor zero"),
        ("integrator", "exponential", "--integrator exponential"),
        ("state", "kept", "--state kept"),
        ("written_by", "sinabs", "--from sinabs"),
        ("like", "norse", "--like norse"),
    ],
)
def test_each_option_is_found_where_it_alone_makes_both_equal(option, choice, cause, tmp_path):
    kinds = {"written_by": partial(nir_if, 1.0), "like": partial(lif, tau=2e-3, r=3.0)}
    usual = partial(cuba, alpha=0.6, beta=0.97, dt=1e-2, threshold=1.0)
    path = network(tmp_path, *(kinds.get(option, usual)(n) for n in (10, 4)))
    recorded = recording(path, tmp_path, **{option: choice})
    words = ["--dt", "1e-3"] if option == "like" else []
    assert f"likeliest cause: {cause}, with" in check(path, "--against", recorded, *words).stdout


def test_three_things_that_files_of_sinabs_leave_open_are_found_together(tmp_path):
    path = network(tmp_path, *(nir_if(1.0, n) for n in (10, 4)))
    given = {"spikes": "reached", "reset": "zero", "floor": "threshold"}
    recorded = recording(path, tmp_path, written_by="sinabs", **given)
    found = check(path, "--from", "sinabs", "--against", recorded)
    cause = "--spikes reached and --reset zero and --floor threshold"
    assert f"likeliest cause: {cause}, with which all are equal" in found.stdout


def test_integrators_of_sinabs_with_a_lowest_membrane_are_equal_with_a_floor():
    # sinabs 3.1.3: Linear(8, 12), IAFSqueeze(min_v_mem=-1), Linear(12, 3), IAFSqueeze
    found = against("sinabs_iaf_min", "sinabs_iaf_min", "--from", "sinabs")
    assert "likeliest cause: --floor threshold, with which all are equal" in found.stdout
    words = ["--from", "sinabs", "--floor", "threshold"]
    assert against("sinabs_iaf_min", "sinabs_iaf_min", *words).exit_code == 0


def test_what_no_option_says_is_named_where_nothing_fits_and_the_search_ends(tmp_path):
    path = network(tmp_path, *(lif(n, tau=1e-3, r=10.0) for n in (10, 4)))
    recorded = recording(path, tmp_path)
    with np.load(recorded) as arrays:
        inputs, outputs = arrays["input"], 1 - arrays["output"]
    np.savez(recorded, input=inputs, output=outputs)
    said = check(path, "--against", recorded, "--from", "snntorch").stdout
    assert "no option makes both equal" in said
    assert "What snntorch does not write and no option says: graded_spikes_factor 1" in said
    artifact = load(path)
    read = read_recorded(recorded, artifact)
    found = find_cause(path, {}, artifact, read, find_difference(artifact, read), longest=0)
    assert (found.cause, found.finished) == ((), False)


def test_a_threshold_that_is_reached_is_told_from_one_that_is_passed(tmp_path):
    # V = x, which is the threshold
    recorded, node = tmp_path / "a.npz", cuba(1, alpha=0.0, beta=0.5, threshold=1.0)
    nir.write(tmp_path / "a.nir", chain(nir.Linear(np.ones((1, 1))), node, width=1, act=1))
    np.savez(recorded, input=np.array([[1], [0], [0]]), output=np.array([[1], [0], [0]]))
    found = check(tmp_path / "a.nir", "--against", recorded)
    assert "likeliest cause: --spikes reached, with which all are equal" in found.stdout


def test_a_file_that_cannot_be_read_alone_is_read_as_each_tool_writes_it():
    found = against("norse_lifcell", "norse_lifcell")
    assert found.exit_code != 0
    assert "With --from norse your framework = our float: equal." in str(found.exception)


def test_without_a_cause_the_nearest_option_is_named(tmp_path):
    with np.load(EXPORTS / "snntorch_leaky_default.npz") as arrays:
        inputs, outputs = arrays["input"], arrays["output"].copy()
    outputs[150, 2] ^= 1
    np.savez(tmp_path / "a.npz", input=inputs, output=outputs, membrane=outputs)
    found = check(LEAKY, "--against", tmp_path / "a.npz", "--reset", "zero", "--json")
    report = json.loads(found.stdout)
    assert report["cause"] == []
    assert report["nearest"] == {"option": "--reset subtract-delayed", "differ": 1}
    assert report["unread"] == ["membrane"]


@pytest.mark.parametrize(
    ("arrays", "message"),
    [
        ({"input": (5, 12)}, "holds the arrays input; needed are `input` and `output`"),
        ({"input": (5, 11), "output": (5, 6)}, r"input has shape \(5, 11\); node 'input' needs"),
        ({"input": (5, 12), "output": (5, 7)}, r"output has shape \(5, 7\)"),
        ({"input": (5, 12), "output": (4, 6)}, r"input has \(B, T\) = \(1, 5\), output \(1, 4\)"),
        ({"input": (5, 1, 12), "output": (5, 1, 6)}, "5 inferences of one timestep"),
    ],
)
def test_wrong_keys_and_shapes_are_named(arrays, message, tmp_path):
    np.savez(tmp_path / "a.npz", **{name: np.zeros(shape) for name, shape in arrays.items()})
    found = check(LEAKY, "--against", tmp_path / "a.npz", "--from", "snntorch")
    with pytest.raises(type(found.exception), match=message):
        raise found.exception


NEEDS = {
    "snntorch": "snntorch.export_nir",
    "norse": "norse.torch",
    "spikingjelly": "spikingjelly.activation_based.nir_exchange",
}


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("tool", NEEDS)
def test_an_example_exports_what_check_finds_equal(tool, tmp_path, monkeypatch):
    reason = f"{tool}'s export is not installed; ./spike test --peers runs its example"
    pytest.importorskip(NEEDS[tool], reason=reason, exc_type=ImportError)
    monkeypatch.setattr(sys, "argv", ["example", str(tmp_path)])
    runpy.run_path(str(ROOT / f"examples/from_{tool}.py"), run_name="__main__")
    found = check(tmp_path / f"{tool}.nir", "--from", tool, "--against", tmp_path / f"{tool}.npz")
    assert "your framework = our float: equal, 400 outputs" in found.stdout


@pytest.mark.parametrize(
    ("words", "said"),
    [(("--chip", "loihi1"), "Give one of them"), (("-o", "out"), "SystemExit(2)")],
)
def test_a_recording_goes_without_chips_and_pages(words, said):
    found = against("snntorch_leaky", "snntorch_leaky_default", *words)
    assert said in repr(found.exception)
