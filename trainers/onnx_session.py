"""ONNX Runtime session of a float network, on one thread and without torch.

An untrusted file can ask for any memory and time. One that computes with the operators of dense
networks alone cannot, and is opened directly. Any other is first tried in a process with limits;
loops and branches are refused, because one trial says nothing about the next inference.

What passes from one control step to the next is an input of the file, and an output of the same
width named `next.INPUT`: a state. It is 0 where an episode begins.
"""

import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime
from numpy.typing import NDArray

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
    """Operators and sizes of an ONNX file.

    names: names of the operators, each as often as it is there.
    nested: whether an operator holds a graph, as loops and branches do, or the file functions.
    shapes: shapes of the constants.
    """

    names: tuple[str, ...]
    nested: bool
    shapes: tuple[tuple[int, ...], ...]

    @property
    def elementary(self) -> bool:
        """True if time and memory of an inference are bounded by the sizes of the constants."""
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

    @property
    def widths(self) -> tuple[int, ...]:
        """Widths of a multilayer perceptron, from its input on; empty where it is none.

        It has as many matrices as products, each of which fits behind the one before, transposed
        or not.
        """
        products = self.names.count("MatMul") + self.names.count("Gemm")
        matrices = [shape for shape in self.shapes if len(shape) == 2]
        if len(matrices) != products:  # a normaliser may be a row
            matrices = [shape for shape in matrices if shape[0] != 1]
        if self.nested or not products or len(matrices) != products:
            return ()
        for first in matrices[0]:
            found = [first]
            for shape in matrices:
                if found[-1] not in shape:
                    break
                found.append(shape[0] if shape[1] == found[-1] else shape[1])
            else:
                return tuple(found)
        return ()


def operators(path: Path) -> OnnxOperators:
    """The operators of a file; ArtifactError where it is no protobuf."""
    try:
        model = list(_fields(path.read_bytes()))
        graphs = [value for number, value in model if number == _GRAPH]
        inside = [field for graph in graphs for field in _fields(graph)]
        nodes = [list(_fields(value)) for number, value in inside if number == _NODE]
        tensors = [value for number, value in inside if number == _INITIALIZER]
        return OnnxOperators(
            tuple(next((v.decode() for n, v in node if n == _OPERATOR), "") for node in nodes),
            any(number == _FUNCTIONS for number, _ in model) or any(map(_has_subgraph, nodes)),
            tuple(tuple(_dims(tensor)) for tensor in tensors),
        )
    except (ValueError, IndexError) as error:
        raise ArtifactError(f"{path} is not an ONNX file that can be run: {error}") from error


def _has_subgraph(node: list[tuple[int, bytes]]) -> bool:
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


_ERRORS_ONLY = 3  # ONNX Runtime's severity level; failures raise exceptions anyway
_BYTES = 512 << 20  # that a trial may take, and for each byte of the file
_BYTES_OF_EACH = 8
_LIBRARIES = 2 << 30  # address space of Python and ONNX Runtime, where the system does not say it
_SECONDS = 10
_LARGEST_FILE = 1 << 30


def session(path: str | Path) -> Any:  # noqa: ANN401
    """Return the onnxruntime.InferenceSession of a file, or raise ArtifactError."""
    file = Path(path)
    if file.is_file():
        found = file.stat()
        _check(file, found.st_size, found.st_mtime_ns)
    network = _opened(path)
    try:  # names and metadata are decoded when they are read
        for each in (*network.get_inputs(), *network.get_outputs()):
            _ = each.name, each.shape
        _ = network.get_modelmeta().custom_metadata_map
    except UnicodeDecodeError as error:
        raise ArtifactError(
            f"{path} has names or metadata that are no text ({error}). Export it again"
        ) from None
    return network


NEXT = "next."  # what the names of states that go out begin with
DTYPES = {"tensor(float)": np.float32, "tensor(double)": np.float64}

States = dict[str, NDArray[np.floating[Any]]]


def initial_states(network: Any) -> States:  # noqa: ANN401
    """Return the states (1, N) of a file by name, as an episode begins; without any, nothing."""
    out = {each.name: (each.type, each.shape[1:]) for each in network.get_outputs()}
    states = {}
    for each in network.get_inputs():
        kind, width = each.type, each.shape[1:]
        is_row = len(width) == 1 and isinstance(width[0], int) and width[0] <= _LARGEST_MATRIX
        if kind in DTYPES and is_row and out.get(f"{NEXT}{each.name}") == (kind, width):
            states[each.name] = np.zeros((1, *width), DTYPES[kind])
    return states


def infer(
    network: Any,  # noqa: ANN401
    names: list[str],
    observation: NDArray[Any],
    states: States,
) -> list[NDArray[Any]]:
    """Return the outputs of these names for observations (B, obs); states are moved on."""
    first = network.get_inputs()[0].name
    found: list[NDArray[Any]] = network.run(
        [*names, *(f"{NEXT}{name}" for name in states)], {first: observation, **states}
    )
    states.update(zip(states, found[len(names) :], strict=True))
    return found[: len(names)]


def has_policy_metadata(network: Any) -> bool:  # noqa: ANN401
    """Return whether its metadata are those of our policies, which fix environment and units."""
    said: dict[str, str] = network.get_modelmeta().custom_metadata_map
    return {"env", "recipe"} <= said.keys()


def _opened(path: str | Path) -> Any:  # noqa: ANN401
    onnxruntime.disable_telemetry_events()  # which its builds for Windows send
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = _ERRORS_ONLY
    try:
        return onnxruntime.InferenceSession(str(path), options, ["CPUExecutionProvider"])
    except Exception as error:  # ONNX Runtime's errors share no other base class
        raise ArtifactError(f"{path} is not an ONNX file that can be run: {error}") from error


@lru_cache(maxsize=64)
def _check(path: Path, size: int, changed: int) -> None:
    """Raise ArtifactError where a file may take any time or memory; once for each version of it."""
    if size > _LARGEST_FILE:
        raise ArtifactError(f"{path} is {size} bytes; at most {_LARGEST_FILE}. Make it smaller.")
    found = operators(path)
    if found.nested:
        raise ArtifactError(
            f"{path} has loops, branches or functions of its own, whose time nothing bounds. "
            "Export the network without them."
        )
    if found.elementary:
        return
    words = [sys.executable, "-c", f"from {__name__} import trial; trial()", str(path)]
    try:
        done = subprocess.run(words, capture_output=True, text=True, timeout=6 * _SECONDS)
    except subprocess.TimeoutExpired:
        why = f"it does not end within {_SECONDS} s"
    else:
        if not done.returncode:
            return
        lines = done.stderr.strip().splitlines()
        limits = f"it takes more than {_SECONDS} s or {_BYTES >> 20} MiB"
        why = lines[-1] if done.returncode == 1 and lines else limits
    raise ArtifactError(
        f"{path} cannot be run once on zeros: {why[:300]}. It has the operators "
        f"{', '.join(sorted(set(found.names)))[:200]}; export a plain dense network."
    )


def trial() -> None:
    """Run a file on zeros, within limits; what the process of `_check` does."""
    import resource

    own = Path("/proc/self/statm")
    taken = int(own.read_text().split()[0]) * resource.getpagesize() if own.exists() else _LIBRARIES
    most = taken + _BYTES + _BYTES_OF_EACH * Path(sys.argv[1]).stat().st_size
    resource.setrlimit(resource.RLIMIT_AS, (most, most))
    resource.setrlimit(resource.RLIMIT_CPU, (_SECONDS, _SECONDS))
    try:
        found = _opened(sys.argv[1])
        zeros = {
            each.name: np.zeros([n if isinstance(n, int) else 1 for n in each.shape], kind)
            for each in found.get_inputs()
            if (kind := DTYPES.get(each.type))
        }
        # other inputs are refused by whoever feeds them
        if len(zeros) == len(found.get_inputs()):
            found.run(None, zeros)
    except Exception as error:  # one line for the process that waits
        sys.exit(" ".join(str(error).split())[-300:])
