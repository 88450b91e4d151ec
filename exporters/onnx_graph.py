"""An ONNX graph, built node by node."""

import hashlib
from collections.abc import Sequence
from typing import Any

import numpy as np
import onnx
from numpy.typing import ArrayLike
from onnx import helper, numpy_helper

_OPSET = 17
_IR_VERSION = 8  # ONNX Runtime 1.17 and newer read both
OBSERVATION = "observation"
OUTPUTS = {"continuous": "action", "discrete": "logits"}  # by a policy's head


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
        self._presynaptic: list[onnx.ValueInfoProto] = []

    def constant(self, name: str, value: ArrayLike) -> str:
        """Add a constant, integers as int64 and anything else as floats; return its name."""
        array = np.asarray(value)
        exact = array.astype(np.int64 if array.dtype.kind == "i" else self._kind)
        self._constants.append(numpy_helper.from_array(exact, name))
        return name

    def node(self, operator: str, inputs: Sequence[str], output: str, **attributes: Any) -> str:  # noqa: ANN401
        """Add a node; return the name of its output."""
        self._nodes.append(helper.make_node(operator, inputs, [output], output, **attributes))
        return output

    def floats(self, flags: str, output: str) -> str:
        """Add 1.0 where a flag is true and 0.0 elsewhere; return its name."""
        return self.node("Cast", [flags], output, to=self._element)

    def column(self, index: int, name: str) -> str:
        """Add the column (B, 1) of the observation at `index`; return its name."""
        place = self.constant(f"{name}_index", [index])
        return self.node("Gather", [OBSERVATION, place], name, axis=1)

    def presynaptic(self, name: str, width: int) -> None:
        """Make the input (B, width) of a weight matrix an output, to count effective operations."""
        self._presynaptic.append(self._rows(name, width))

    def state(self, name: str, width: int) -> str:
        """Add an input (B, width), what the step before left; return its name."""
        self._states.append(self._rows(name, width))
        return name

    def next_state(self, name: str, value: str, width: int) -> None:
        """Make a value the output of this name, which the next step takes for the state."""
        self.node("Identity", [value], name)
        self._next.append(self._rows(name, width))

    def _rows(self, name: str, width: int) -> onnx.ValueInfoProto:
        return helper.make_tensor_value_info(name, self._element, ["B", width])

    def sha256(self) -> str:
        """SHA-256 of the constants, in the order in which they were added."""
        sha = hashlib.sha256()
        for constant in self._constants:
            sha.update(f"{constant.name} {list(constant.dims)}".encode())
            sha.update(numpy_helper.to_array(constant).tobytes())
        return sha.hexdigest()

    def model(
        self, observations: int, actions: int, head: str, properties: dict[str, str]
    ) -> onnx.ModelProto:
        """Return the checked model, observation (B, obs) to the output (B, act) of a head.

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
        return model
