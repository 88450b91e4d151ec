"""ONNX graphs written as formulas: values that add, multiply and compare become nodes."""

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias, Union

import numpy as np
import onnx
from numpy.typing import ArrayLike
from onnx import helper, numpy_helper

from spikedeploy.runtime.files import replacing
from spikedeploy.trainers.onnx_session import NEXT

_OPSET = 17
_IR_VERSION = 8  # ONNX Runtime 1.17 and newer read both
OBSERVATION = "observation"
OUTPUTS = {"continuous": "action", "discrete": "logits"}  # by a policy's head

Operand: TypeAlias = Union["Value", ArrayLike]


@dataclass(frozen=True)
class Value:
    """A result of a graph; other operands become constants of the graph."""

    graph: "OnnxGraph"
    name: str

    def __add__(self, other: Operand) -> "Value":
        return self.graph.node("Add", self, other)

    def __sub__(self, other: Operand) -> "Value":
        return self.graph.node("Sub", self, other)

    def __mul__(self, other: Operand) -> "Value":
        return self.graph.node("Mul", self, other)

    def __truediv__(self, other: Operand) -> "Value":
        return self.graph.node("Div", self, other)

    def __matmul__(self, other: Operand) -> "Value":
        return self.graph.node("MatMul", self, other)

    def __gt__(self, other: Operand) -> "Value":
        return self.graph.node("Greater", self, other)

    def clip(self, most: float) -> "Value":
        """The value within -most and most."""
        return self.graph.node("Clip", self, -most, most)

    def reshape(self, *shape: int) -> "Value":
        """The value in another shape."""
        return self.graph.node("Reshape", self, np.array(shape))


class OnnxGraph:
    """Nodes and constants from the observation to the output.

    kind: the type of all floats, float32 or float64.
    """

    def __init__(self, kind: type[np.floating[Any]] = np.float32) -> None:
        self._kind, self._element = kind, helper.np_dtype_to_tensor_dtype(np.dtype(kind))
        self._states: list[onnx.ValueInfoProto] = []
        self._next: list[onnx.ValueInfoProto] = []
        self._nodes: list[onnx.NodeProto] = []
        self._constants: list[onnx.TensorProto] = []
        self._scalars: dict[float, Value] = {}
        self._presynaptic: list[onnx.ValueInfoProto] = []
        self.observation = Value(self, OBSERVATION)

    def constant(self, value: ArrayLike, name: str = "") -> Value:
        """Add a constant, integers as int64 and anything else as floats."""
        array = np.asarray(value)
        if not name and array.ndim == 0 and float(array) in self._scalars:
            return self._scalars[float(array)]
        whole = array.ndim > 0 and array.dtype.kind == "i"
        found = Value(self, name or f"c{len(self._constants)}")
        exact = array.astype(np.int64 if whole else self._kind)
        self._constants.append(numpy_helper.from_array(exact, found.name))
        if not name and array.ndim == 0:
            self._scalars[float(array)] = found
        return found

    def node(self, operator: str, *operands: Operand, name: str = "", **attributes: Any) -> Value:  # noqa: ANN401
        """Add a node; return its output. An operand "" is omitted."""
        inputs = [self._name(each) for each in operands]
        output = name or f"n{len(self._nodes)}"
        self._nodes.append(helper.make_node(operator, inputs, [output], output, **attributes))
        return Value(self, output)

    def _name(self, operand: Operand) -> str:
        if isinstance(operand, Value):
            return operand.name
        return "" if isinstance(operand, str) else self.constant(operand).name

    def floats(self, flags: Value) -> Value:
        """1.0 where a flag is true and 0.0 elsewhere."""
        return self.node("Cast", flags, to=self._element)

    def normalised(self, mean: ArrayLike, std: ArrayLike, clip: float) -> Value:
        """The observation with its mean and deviation taken out, within a clip."""
        # x = clip((obs - mean) / std)
        return ((self.observation - mean) / std).clip(clip)

    def presynaptic(self, value: Value, width: int) -> None:
        """Make the input (B, width) of a weight matrix an output, to count effective operations."""
        self._presynaptic.append(self._rows(value.name, width))

    def state(self, name: str, width: int) -> Value:
        """Add an input (B, width), what the step before left."""
        self._states.append(self._rows(name, width))
        return Value(self, name)

    def next_state(self, name: str, value: Value, width: int) -> None:
        """Make a value the output that the next step takes for the state of this name."""
        self.node("Identity", value, name=f"{NEXT}{name}")
        self._next.append(self._rows(f"{NEXT}{name}", width))

    def _rows(self, name: str, width: int) -> onnx.ValueInfoProto:
        return helper.make_tensor_value_info(name, self._element, ["B", width])

    def sha256(self) -> str:
        """SHA-256 of the constants, in the order in which they were added."""
        sha = hashlib.sha256()
        for constant in self._constants:
            sha.update(f"{constant.name} {list(constant.dims)}".encode())
            sha.update(numpy_helper.to_array(constant).tobytes())
        return sha.hexdigest()

    def write(
        self, path: Path, observations: int, actions: int, head: str, properties: dict[str, str]
    ) -> Path:
        """Write the checked model, observation (B, obs) to the output (B, act) of a head.

        States come in after the observation, and go out last.
        """
        graph = helper.make_graph(
            self._nodes,
            "policy",
            [self._rows(OBSERVATION, observations), *self._states],
            [self._rows(OUTPUTS[head], actions), *self._presynaptic, *self._next],
            self._constants,
        )
        opsets = [helper.make_opsetid("", _OPSET)]
        model = helper.make_model(
            graph, opset_imports=opsets, ir_version=_IR_VERSION, producer_name="spikedeploy"
        )
        helper.set_model_props(model, properties)
        onnx.checker.check_model(model, full_check=True)
        with replacing(path) as temporary:
            temporary.write_bytes(model.SerializeToString(deterministic=True))
        return path
