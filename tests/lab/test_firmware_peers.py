"""What benchmarks of C give to emlearn and snn-mlir, and the tables that they write."""

import numpy as np
import pytest

from lab.firmware import dense, snn_to_linalg
from lab.firmware.table import INTEGERS, NETWORKS, OWN, PAGE, PEERS, table
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
    policy = dense.read(zoo.path(name))
    rows = np.random.default_rng(0).normal(size=(50, len(policy.mean)))
    wanted = OnnxController(zoo.path(name)).replay(rows)
    found = forward(policy, rows)
    if policy.chooses:
        assert (found.argmax(axis=1) == wanted).all()
    else:
        assert np.abs(found - wanted).max() < 1e-5


def test_a_policy_that_is_more_than_layers_is_passed_over():
    assert dense.read(zoo.path("hexapod/bilinear")) is None


def test_observations_of_a_self_test_are_those_of_its_c(tmp_path):
    values = ", ".join(value.hex() for value in (0.5, -1.25, 3.0, 0.0))
    (tmp_path / "vectors.h").write_text(
        "#define VECTOR_INFERENCES 2u\n"
        f"static const double vector_observation[4] = {{\n{values},\n}};"
    )
    assert dense.read_observations(tmp_path).tolist() == [[0.5, -1.25], [3.0, 0.0]]


MODULE = """module {
    snn.linear ins(%x, %w) bias(%b : memref<2xi32>) out(%y) {w_scale = 7 : i64} : memref<3xi8>, memref<2x3xi8> -> memref<2xi32>
    snn.rescale ins(%y) out(%z) {w_scale = 7 : i64, d_scale = 12 : i64} : memref<2xi32> -> memref<2xi32>
    snn.lif ins(%z) state(%v) out(%s) {d_scale = 12 : i64, decay_int = 3686 : i64, threshold_int = 2867 : i64, v_reset_int = 0 : i64} : memref<2xi32>, memref<2xi32> -> memref<2xi8>
    snn.cubalif ins(%f) state(%c, %u) out(%g) {cur_decay_float = 9.0e-01 : f64, vol_decay_float = 8.0e-01 : f64, threshold_float = 5.0e-01 : f64} : memref<2xf32>, memref<2xf32>, memref<2xf32> -> memref<2xf32>
}"""  # noqa: E501 - as snn-mlir writes it


def test_operations_of_snn_mlir_become_those_of_mlir():
    found = snn_to_linalg.lower(MODULE)
    assert "snn." not in found
    assert "outs(%y : memref<2xi32>)" in found
    assert "%by = arith.constant 5 : i32" in found  # 12 - 7
    assert "outs(%v, %s : memref<2xi32>, memref<2xi8>)" in found
    assert "arith.constant 3686 : i64" in found
    assert "outs(%c, %u, %g : memref<2xf32>, memref<2xf32>, memref<2xf32>)" in found
    assert "linalg.yield %n0, %left, %spike : f32, f32, f32" in found


@pytest.mark.parametrize(
    "line",
    [
        "    snn.li ins(%x) state(%v) out(%y) {decay_float = 1.0 : f64} : memref<2xf32>",
        "    snn.lif ins(%z) state(%v) out(%s) {decay_float = 0.9 : f64, threshold_float = 0.5 : "
        "f64, v_reset_float = -1.0 : f64} : memref<2xf32>, memref<2xf32> -> memref<2xf32>",
    ],
)
def test_what_is_not_translated_is_refused(line):
    with pytest.raises(ValueError, match="not translated"):
        snn_to_linalg.lower(line)


@pytest.mark.parametrize("place", [OWN, PEERS, NETWORKS, INTEGERS])
def test_a_table_on_the_page_has_the_columns_of_its_command(place):
    page = PAGE.read_text(encoding="utf-8")
    there = page.split(f"<!-- {place} -->")[1].split(f"<!-- end of {place} -->")[0]
    assert table(place, []) in there
