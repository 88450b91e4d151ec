"""What benchmarks/firmware_peers.py gives to emlearn is what ONNX Runtime plays."""

import numpy as np
import pytest

from benchmarks import firmware_dense
from benchmarks.firmware_table import PAGE, PEERS, peer_table
from spikedeploy import zoo
from spikedeploy.policies.onnx import OnnxController


def forward(policy, rows):
    """Outputs of a dense policy, as dense.c and emlearn compute them."""
    found = np.clip((rows.astype(np.float32) - policy.mean) * policy.factor, *policy.clip)
    kinds = {"relu": lambda x: np.maximum(x, 0), "tanh": np.tanh, "identity": lambda x: x}
    for weight, bias, kind in zip(policy.weights, policy.biases, policy.activations, strict=True):
        found = kinds[kind](found @ weight + bias)
    return found


@pytest.mark.parametrize("name", ["hexapod/linear", "hexapod-command/mlp-64", "kart-grid/small"])
def test_layers_that_are_read_compute_what_the_onnx_file_does(name):
    policy = firmware_dense.read(zoo.path(name))
    rows = np.random.default_rng(0).normal(size=(50, len(policy.mean)))
    wanted = OnnxController(zoo.path(name)).replay(rows)
    found = forward(policy, rows)
    if policy.chooses:
        assert (found.argmax(axis=1) == wanted).all()
    else:
        assert np.abs(found - wanted).max() < 1e-5


def test_a_policy_that_is_more_than_layers_is_passed_over():
    assert firmware_dense.read(zoo.path("hexapod/bilinear")) is None


def test_observations_of_a_self_test_are_those_of_its_c(tmp_path):
    values = ", ".join(value.hex() for value in (0.5, -1.25, 3.0, 0.0))
    (tmp_path / "vectors.h").write_text(
        "#define VECTOR_INFERENCES 2u\n"
        f"static const double vector_observation[4] = {{\n{values},\n}};"
    )
    assert firmware_dense.recorded(tmp_path).tolist() == [[0.5, -1.25], [3.0, 0.0]]


def test_the_table_on_the_page_has_the_columns_of_the_command():
    head = peer_table([]).splitlines()[0]
    assert f"<!-- {PEERS} -->\n{head}" in PAGE.read_text(encoding="utf-8")
