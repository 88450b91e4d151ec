"""ONNX files of others: one sentence, whatever they hold; no unbounded loop or memory."""

import numpy as np
import onnx
import onnxruntime
import pytest
from onnx import TensorProto, helper, numpy_helper

from spikedeploy import zoo
from spikedeploy.policies.onnx import OnnxController
from spikedeploy.runtime.errors import ArtifactError, ObservationError
from spikedeploy.trainers.onnx_session import operators, session

FLOAT, INT, STRING = TensorProto.FLOAT, TensorProto.INT64, TensorProto.STRING


def value(name, shape, kind=FLOAT):
    return helper.make_tensor_value_info(name, kind, shape)


def model(path, nodes=None, inputs=None, outputs=None, constants=None, said=None, weight=None):
    """Two observations to one action by a matrix, but for what is given."""
    weight = np.ones((2, 1), np.float32) if weight is None else weight
    constants = {"w": weight, **(constants or {})}
    graph = helper.make_graph(
        nodes or [helper.make_node("MatMul", ["x", "w"], ["y"])],
        "g",
        [value("x", ["B", 2])] if inputs is None else inputs,
        outputs or [value("y", ["B", 1])],
        [numpy_helper.from_array(np.asarray(a), n) for n, a in constants.items()],
    )
    made = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    helper.set_model_props(made, said or {})
    path.write_bytes(made.SerializeToString())
    return path


def endless(path):
    body = helper.make_graph(
        [helper.make_node("Identity", ["go"], ["on"]), helper.make_node("Identity", ["a"], ["b"])],
        "body",
        [value("i", [], INT), value("go", [], TensorProto.BOOL), value("a", ["B", 2])],
        [value("on", [], TensorProto.BOOL), value("b", ["B", 2])],
    )
    loop = helper.make_node("Loop", ["", "yes", "x"], ["z"], body=body)
    nodes = [loop, helper.make_node("MatMul", ["z", "w"], ["y"])]
    return model(path, nodes, constants={"yes": np.array(True)})


def huge(path):
    made = helper.make_node("ConstantOfShape", ["n"], ["big"])
    total = helper.make_node("ReduceMax", ["big"], ["top"], keepdims=0)
    nodes = [made, total, helper.make_node("MatMul", ["x", "w"], ["p"])]
    nodes.append(helper.make_node("Add", ["p", "top"], ["y"]))
    return model(path, nodes, constants={"n": np.array([1 << 28])})


def test_telemetry_is_off_before_a_file_is_opened(tmp_path, monkeypatch):
    order = []
    opened = onnxruntime.InferenceSession
    monkeypatch.setattr(onnxruntime, "disable_telemetry_events", lambda: order.append("off"))
    monkeypatch.setattr(
        onnxruntime,
        "InferenceSession",
        lambda *given: order.append("opened") or opened(*given),
    )
    session(model(tmp_path / "a.onnx"))
    assert order == ["off", "opened"]


REFUSED = {
    "endless loop": (endless, "loops, branches or functions"),
    "1 GiB": (huge, "cannot be run once on zeros"),
    "macs": ({"said": {"macs": "abc"}}, "'macs': 'abc'"),
    "nan macs": ({"said": {"macs": "nan"}}, "'macs': 'nan'"),
    "fan_out": ({"said": {"fan_out": "[[1], 2]"}}, "fan_out"),
    "deep": ({"said": {"fan_out": "[" * 100_000}}, "fan_out"),
    "batch 7": ({"inputs": [value("x", [7, 2])], "outputs": [value("y", [7, 1])]}, r"\[\[7, 2\]\]"),
    "two inputs": ({"inputs": [value("x", ["B", 2]), value("z", ["B", 2])]}, "has 2 inputs"),
    "string": (
        {
            "nodes": [helper.make_node("Identity", ["x"], ["y"])],
            "inputs": [value("x", ["B", 2], STRING)],
            "outputs": [value("y", ["B", 2], STRING)],
        },
        r"'x' is a tensor\(string\)",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_no_policy_is_refused_in_one_sentence(name, tmp_path):
    write, message = REFUSED[name]
    path = tmp_path / "a.onnx"
    write(path) if callable(write) else model(path, **write)
    with pytest.raises(ArtifactError, match=message):
        OnnxController(path)


def test_metadata_that_are_no_text_are_refused(tmp_path):
    path = model(tmp_path / "a.onnx", said={"env": "XXXX"})
    path.write_bytes(path.read_bytes().replace(b"XXXX", b"\xff\xfe\xff\xfe"))
    with pytest.raises(ArtifactError):
        OnnxController(path)


def test_nan_weights_stop_the_first_inference(tmp_path):
    path = model(tmp_path / "a.onnx", weight=np.array([[np.nan], [1]], np.float32))
    with pytest.raises(ObservationError, match="puts out NaN or infinity"):
        OnnxController(path).act(np.zeros(2))


def test_a_batch_of_one_is_run_row_by_row(tmp_path):
    path = model(tmp_path / "a.onnx", inputs=[value("x", [1, 2])], outputs=[value("y", [1, 1])])
    found = OnnxController(path).replay(np.array([[1.0, 2.0], [3.0, 4.0]]))
    np.testing.assert_array_equal(found, [[3], [7]])


def test_other_operators_run_after_a_trial(tmp_path):
    nodes = [
        helper.make_node("Softmax", ["x"], ["s"]),
        helper.make_node("MatMul", ["s", "w"], ["y"]),
    ]
    assert OnnxController(model(tmp_path / "a.onnx", nodes)).act(np.zeros(2)) == [1.0]


@pytest.mark.parametrize("path", sorted(zoo.FOLDER.rglob("*.onnx")), ids=lambda p: p.stem)
def test_shipped_policies_without_convolutions_need_no_trial(path):
    found = operators(path)
    assert found.elementary == ("Conv" not in found.names)
    known = onnx.load(path).graph
    assert found.names == tuple(node.op_type for node in known.node)
    assert found.shapes == tuple(tuple(each.dims) for each in known.initializer)


def test_constants_whose_product_is_huge_are_no_plain_network(tmp_path):
    outer = {"a": np.ones((20_000, 1), np.float32), "b": np.ones((1, 20_000), np.float32)}
    assert not operators(model(tmp_path / "a.onnx", constants=outer)).elementary


@pytest.mark.parametrize("content", [b"\x0b", b"\x3a\xff", b"\xff" * 20])
def test_bytes_that_are_no_protobuf_are_refused(content, tmp_path):
    (tmp_path / "a.onnx").write_bytes(content)
    with pytest.raises(ArtifactError, match="is not an ONNX file that can be run"):
        session(tmp_path / "a.onnx")


def test_tensors_that_do_not_fit_are_refused_when_the_file_is_run(tmp_path):
    two = value("y", ["B", None])
    path = model(tmp_path / "a.onnx", weight=np.ones((3, 1), np.float32), outputs=[two])
    with pytest.raises(ArtifactError):
        OnnxController(path).act(np.zeros(2))


def test_counts_of_other_matrices_are_refused(tmp_path):
    hidden = [helper.make_node("MatMul", ["x", "w"], ["y"]), helper.make_node("Relu", ["x"], ["r"])]
    ends = [value("y", ["B", 1]), value("r", ["B", 2])]
    for counts in ("[[1, 1, 1]]", "[[1, 1], [1]]", "[]"):
        path = model(tmp_path / "a.onnx", hidden, outputs=ends, said={"fan_out": counts})
        with pytest.raises(ArtifactError, match="says fan_out of"):
            OnnxController(path).effective_macs(np.zeros((3, 2)))
