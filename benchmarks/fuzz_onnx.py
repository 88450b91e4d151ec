"""Mutations of an ONNX file: its operators, attributes, constants, tensors and metadata."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

Rng: TypeAlias = np.random.Generator
# what a dense network is made of, which is opened without a trial
PLAIN = ("Add", "Clip", "Concat", "Div", "Gather", "Gemm", "Identity", "MatMul", "Mul", "Relu",
         "Sigmoid", "Sub", "Tanh")  # fmt: skip
# any other is tried in a process of its own, which takes most of a second
OTHER = ("Softmax", "ConstantOfShape", "Expand", "Tile", "NonZero", "Loop", "If", "Scan", "Range",
         "RandomNormal", "Resize", "Foo", "")  # fmt: skip
KEYS = ("env", "macs", "seed", "fan_out", "kind", "recipe", "steps", "observation", "version")
TEXTS = ("", "abc", "nan", "-1", "1e999", "9" * 5000, "[[1], 2]", "[" * 5000, "{}", "null", "é",
         "true", "[[1, 2, 3, 4]]", "0", "spikedeploy/KartGrid-v0")  # fmt: skip
LENGTHS = (0, -1, 1, 2, 3, 4, 7, 300, 2**20, 2**31, 2**62)


def _changed(change: Callable[[Any, Rng], None]) -> Callable[[Path, Rng], None]:
    """The change of a model as one of its file."""

    def of_file(path: Path, rng: Rng) -> None:
        model = onnx.load_model_from_string(path.read_bytes())
        change(model, rng)
        path.write_bytes(model.SerializeToString())

    of_file.__name__ = change.__name__
    of_file.__doc__ = change.__doc__
    return of_file


def _any(items: Any, rng: Rng) -> Any:  # noqa: ANN401
    return items[int(rng.integers(len(items)))]


def other_operator(model: Any, rng: Rng) -> None:  # noqa: ANN401
    """A node computes something else."""
    _any(model.graph.node, rng).op_type = _any(PLAIN if rng.random() < 0.95 else OTHER, rng)


def other_node(model: Any, rng: Rng) -> None:  # noqa: ANN401
    """A node is missing, there twice, or one more puts out what another takes."""
    nodes = model.graph.node
    chosen = _any(nodes, rng)
    if rng.random() < 0.4:
        nodes.remove(chosen)
    elif rng.random() < 0.5:
        nodes.append(chosen)
    else:
        taken = [str(each) for each in chosen.input]
        nodes.insert(0, helper.make_node(_any(PLAIN, rng), taken[:1], [f"m{rng.integers(9)}"]))


def other_wire(model: Any, rng: Rng) -> None:  # noqa: ANN401
    """A tensor has another name, so that a node takes or puts out another one."""
    node = _any(model.graph.node, rng)
    names = ["x", "y", "h", "r", "w", "v", "", "nobody"]
    side = node.input if rng.random() < 0.5 else node.output
    side[int(rng.integers(len(side)))] = _any(names, rng)


def other_constant(model: Any, rng: Rng) -> None:  # noqa: ANN401
    """A constant has other numbers, axes or another type, or fewer bytes than it says."""
    at = int(rng.integers(len(model.graph.initializer)))
    tensor = model.graph.initializer[at]
    old = numpy_helper.to_array(tensor)
    values: list[Any] = [
        np.full_like(old, np.nan), np.full_like(old, np.inf), old.T.copy(), old[None], old[:0],
        old.astype(np.float64), old.astype(np.int64), old.astype(np.float16), old * 1e30,
        np.ones((3, 3, 3), np.float32), np.ones((), np.float32), np.array(["a"] * 4),
    ]  # fmt: skip
    if rng.random() < 0.2:
        tensor.raw_data = tensor.raw_data[: int(rng.integers(len(tensor.raw_data)))]
    elif rng.random() < 0.2:
        tensor.dims[int(rng.integers(len(tensor.dims)))] = _any(LENGTHS, rng)
    elif rng.random() < 0.1:
        tensor.data_location = TensorProto.EXTERNAL
        tensor.external_data.add(key="location", value=_any(["/etc/passwd", "../x", "x"], rng))
    else:
        tensor.CopyFrom(numpy_helper.from_array(_any(values, rng), tensor.name))


def other_end(model: Any, rng: Rng) -> None:  # noqa: ANN401
    """An input or output has another shape or type, is missing, or there is one more."""
    ends = model.graph.input if rng.random() < 0.6 else model.graph.output
    kind = _any((TensorProto.FLOAT, TensorProto.INT64, TensorProto.STRING, TensorProto.DOUBLE), rng)
    shape = [_any(("B", *LENGTHS), rng) for _ in range(int(rng.integers(0, 4)))]
    if rng.random() < 0.15:
        del ends[0]
    elif rng.random() < 0.2:
        ends.append(helper.make_tensor_value_info("more", kind, shape))
    elif rng.random() < 0.3:
        ends[0].name = _any(("x", "y", "r", "", "nobody"), rng)
    else:
        ends[0].CopyFrom(helper.make_tensor_value_info(ends[0].name, kind, shape))


def other_metadata(model: Any, rng: Rng) -> None:  # noqa: ANN401
    """Our metadata say something else."""
    said = {each.key: each.value for each in model.metadata_props}
    said[_any(KEYS, rng)] = _any(TEXTS, rng)
    helper.set_model_props(model, said)


def other_attribute(model: Any, rng: Rng) -> None:  # noqa: ANN401
    """A node has an attribute, of any type and any size."""
    names = ("axis", "alpha", "beta", "transA", "transB", "min", "max", "to", "x")
    values = (0, -1, 1, 2**62, 1e30, float("nan"), "text", [1, 2], [0.5], [2**40] * 3)
    node = _any(model.graph.node, rng)
    node.attribute.append(helper.make_attribute(_any(names, rng), _any(values, rng)))


def other_version(model: Any, rng: Rng) -> None:  # noqa: ANN401
    """Versions of the format and of the operators, domains and functions of its own."""
    numbers = (0, -1, 1, 7, 13, 99, 2**62)
    if rng.random() < 0.4:
        model.ir_version = _any(numbers, rng)
    elif rng.random() < 0.6:
        model.opset_import[0].version = _any(numbers, rng)
    elif rng.random() < 0.5:
        _any(model.graph.node, rng).domain = "com.somebody"
    else:
        model.functions.add().name = "f"


ONNX = [
    _changed(change)
    for change in (
        other_operator, other_node, other_wire, other_constant, other_constant, other_end,
        other_metadata, other_metadata, other_attribute, other_version,
    )
]  # fmt: skip
