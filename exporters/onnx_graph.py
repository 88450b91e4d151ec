"""An ONNX graph, built node by node."""

import hashlib
from collections.abc import Sequence
from typing import Any

import numpy as np
import onnx
from numpy.typing import ArrayLike
from onnx import TensorProto, helper, numpy_helper

_OPSET = 17
_IR_VERSION = 8  # ONNX Runtime 1.17 and newer read both
OBSERVATION = "observation"
OUTPUTS = {"continuous": "action", "discrete": "logits"}  # by a policy's head


class OnnxGraph:
    """Nodes and constants from the observation to the output, in float32."""

    def __init__(self) -> None:
        self._nodes: list[onnx.NodeProto] = []
        self._constants: list[onnx.TensorProto] = []
        self._presynaptic: list[onnx.ValueInfoProto] = []

    def constant(self, name: str, value: ArrayLike) -> str:
        """Add a constant, integers as int64 and anything else as float32; return its name."""
        array = np.asarray(value)
        exact = array.astype(np.int64 if array.dtype.kind == "i" else np.float32)
        self._constants.append(numpy_helper.from_array(exact, name))
        return name

    def node(self, operator: str, inputs: Sequence[str], output: str, **attributes: Any) -> str:  # noqa: ANN401
        """Add a node; return the name of its output."""
        self._nodes.append(helper.make_node(operator, inputs, [output], output, **attributes))
        return output

    def column(self, index: int, name: str) -> str:
        """Add the column (B, 1) of the observation at `index`; return its name."""
        place = self.constant(f"{name}_index", [index])
        return self.node("Gather", [OBSERVATION, place], name, axis=1)

    def presynaptic(self, name: str, width: int) -> None:
        """Make the input (B, width) of a weight matrix an output, to count effective operations."""
        self._presynaptic.append(
            helper.make_tensor_value_info(name, TensorProto.FLOAT, ["B", width])
        )

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
        """Return the checked model, observation (B, obs) to the output (B, act) of a head."""
        graph = helper.make_graph(
            self._nodes,
            "policy",
            [helper.make_tensor_value_info(OBSERVATION, TensorProto.FLOAT, ["B", observations])],
            [
                helper.make_tensor_value_info(OUTPUTS[head], TensorProto.FLOAT, ["B", actions]),
                *self._presynaptic,
            ],
            self._constants,
        )
        opsets = [helper.make_opsetid("", _OPSET)]
        model = helper.make_model(
            graph, opset_imports=opsets, ir_version=_IR_VERSION, producer_name="spikedeploy"
        )
        helper.set_model_props(model, properties)
        onnx.checker.check_model(model, full_check=True)
        return model
