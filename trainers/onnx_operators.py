"""The operators and constants of an ONNX file, read from its bytes before anything is run.

An ONNX file is a protobuf message: fields of a number and a value, which is a varint, eight bytes,
a length and as many bytes, or four bytes. Only the few fields that are needed are known here
(onnx/onnx.proto3), so that a policy runs where the package `onnx` is not installed.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from spikedeploy.runtime.errors import ArtifactError

# fields of ModelProto, GraphProto, NodeProto, AttributeProto and TensorProto
_GRAPH, _FUNCTIONS = 7, 25
_NODE, _INITIALIZER = 1, 5
_OPERATOR, _ATTRIBUTE = 4, 5
_SUBGRAPH, _SUBGRAPHS = 6, 11
_DIMS = 1
# what a dense network needs; none of them makes more of a tensor than its inputs and weights say
_ELEMENTARY = {
    "Add", "Clip", "Concat", "Div", "Gather", "Gemm", "Identity", "MatMul", "Mul", "Relu",
    "Sigmoid", "Sub", "Tanh",
}  # fmt: skip
_MOST_NODES, _MOST_CONCATS, _LARGEST_MATRIX = 512, 16, 1 << 24


@dataclass(frozen=True)
class OnnxOperators:
    """What an ONNX file computes with.

    names: of the operators, each as often as it is there.
    nested: whether an operator holds a graph, as loops and branches do, or the file functions.
    shapes: of the constants.
    """

    names: tuple[str, ...]
    nested: bool
    shapes: tuple[tuple[int, ...], ...]

    @property
    def elementary(self) -> bool:
        """Whether time and memory of an inference are bounded by the sizes of the constants."""
        lengths = sorted((n for shape in self.shapes for n in shape), reverse=True)
        largest = lengths[0] * lengths[1] if len(lengths) > 1 else 0
        return (
            not self.nested
            and set(self.names) <= _ELEMENTARY
            and len(self.names) <= _MOST_NODES
            and self.names.count("Concat") <= _MOST_CONCATS
            and all(len(shape) <= 2 for shape in self.shapes)
            and largest <= _LARGEST_MATRIX
        )


def operators(path: Path) -> OnnxOperators:
    """The operators of a file; ArtifactError where it is no protobuf."""
    try:
        model = list(_fields(path.read_bytes()))
        graphs = [value for number, value in model if number == _GRAPH]
        inside = [field for graph in graphs for field in _fields(graph)]
        nodes = [list(_fields(value)) for number, value in inside if number == _NODE]
        tensors = [value for number, value in inside if number == _INITIALIZER]
        return OnnxOperators(
            tuple(_operator(node) for node in nodes),
            any(number == _FUNCTIONS for number, _ in model) or any(map(_nested, nodes)),
            tuple(tuple(_dims(tensor)) for tensor in tensors),
        )
    except (ValueError, IndexError) as error:
        raise ArtifactError(f"{path} is not an ONNX file that can be run: {error}") from error


def _operator(node: list[tuple[int, bytes]]) -> str:
    return next((v.decode() for number, v in node if number == _OPERATOR), "")


def _nested(node: list[tuple[int, bytes]]) -> bool:
    attributes = (value for number, value in node if number == _ATTRIBUTE)
    return any(n in (_SUBGRAPH, _SUBGRAPHS) for each in attributes for n, _ in _fields(each))


def _dims(tensor: bytes) -> Iterator[int]:
    """The lengths of a tensor's axes, one for each field or packed into one."""
    for number, value in _fields(tensor):
        at = 0
        while number == _DIMS and at < len(value):
            length, at = _varint(value, at)
            yield length


def _fields(message: bytes) -> Iterator[tuple[int, bytes]]:
    """Number and value of each field; a varint as its bytes."""
    at = 0
    while at < len(message):
        key, at = _varint(message, at)
        kind = key & 7
        if kind == 0:
            _, end = _varint(message, at)
        elif kind == 2:
            length, at = _varint(message, at)
            end = at + length
        elif kind in (1, 5):
            end = at + (8 if kind == 1 else 4)
        else:
            raise ValueError(f"no protobuf field is of kind {kind}")
        if end > len(message):
            raise ValueError("a field is longer than the file")
        yield key >> 3, message[at:end]
        at = end


def _varint(message: bytes, at: int) -> tuple[int, int]:
    """A number of seven bits a byte, the lowest first, and where it ends."""
    value = 0
    for place in range(10):
        byte = message[at + place]
        value |= (byte & 127) << (7 * place)
        if byte < 128:
            return value, at + place + 1
    raise ValueError("a number is longer than ten bytes")
