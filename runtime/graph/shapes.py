"""Shapes of a graph: what each node takes and puts out, and how much work a timestep is.

Also windows of convolutions and pools: the positions of a kernel along each axis of its input.
Shape letters besides the usual: **R** rows (batch and time in one axis), **C** channels,
**X** spatial extents of the input, **P** positions of the kernel, **K** extents of the kernel.

`nir` infers shapes too, but takes the height of a kernel for its width, the channels of one group
for all of them, and padding 'same' for unchanged extents whatever the stride; so its result is
replaced. The work follows from shapes alone, before anything is computed.
"""

import math
from dataclasses import dataclass
from typing import Any, TypeAlias

import nir
import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from spikedeploy.runtime.errors import ArtifactError, node_error
from spikedeploy.runtime.graph.discretisation import NEURONS

Shape: TypeAlias = tuple[int, ...]

DENSE = (nir.Affine, nir.Linear)
CONVOLUTIONS = (nir.Conv1d, nir.Conv2d)
POOLS = (nir.SumPool2d, nir.AvgPool2d)
# kinds with one parameter for every value that they take
ELEMENTWISE = (*NEURONS, nir.Threshold, nir.Scale, nir.Delay)

# values of one timestep: a node with more is taken for a mistake that would exhaust the memory
MAX_VALUES = 1 << 24
# multiplications of a node in one timestep beyond which it is taken for a mistake; large networks
# for images have as many in all layers together
_MAX_MULTIPLICATIONS = 1 << 33
# values that the windows of a convolution may hold together
_MAX_WINDOW_VALUES = 1 << 26


@dataclass(frozen=True)
class ConvWindow:
    """Geometry of a kernel; one number per axis, as torch.nn.functional.conv2d defines them.

    kernel: K, its elements.
    stride: distance of neighbouring positions.
    padding: zeros before and after the input.
    dilation: distance of neighbouring kernel elements.
    """

    kernel: Shape
    stride: Shape
    padding: tuple[tuple[int, int], ...]
    dilation: Shape

    @property
    def span(self) -> Shape:
        """Extents of the dilated kernel."""
        pairs = zip(self.kernel, self.dilation, strict=True)
        return tuple(dilation * (kernel - 1) + 1 for kernel, dilation in pairs)

    def padded(self, extents: Shape) -> Shape:
        """Extents X with the padding."""
        pairs = zip(extents, self.padding, strict=True)
        return tuple(extent + sum(padding) for extent, padding in pairs)

    def positions(self, extents: Shape) -> Shape:
        """P of each axis for extents X; 0 or less where the kernel does not fit."""
        axes = zip(self.padded(extents), self.span, self.stride, strict=True)
        return tuple((extent - span) // stride + 1 for extent, span, stride in axes)

    def view(self, x: NDArray[Any]) -> NDArray[Any]:
        """The input under the kernel, (R, C, *P, *K) of x (R, C, *X); a view unless x is padded."""
        if any(map(any, self.padding)):
            x = np.pad(x, ((0, 0), (0, 0), *self.padding))
        windows = sliding_window_view(x, self.span, axis=tuple(range(2, x.ndim)))
        whole = (slice(None), slice(None))
        steps = tuple(slice(None, None, step) for step in (*self.stride, *self.dilation))
        return np.asarray(windows[whole + steps])


def window_of(name: str, node: nir.NIRNode) -> ConvWindow:
    """The window of a convolution or pool; ArtifactError where its fields are not one."""
    axes = 1 if isinstance(node, nir.Conv1d) else 2
    if isinstance(node, POOLS):
        kernel = whole_numbers(name, "kernel_size", node.kernel_size, axes, 1)
        dilation: Shape = (1, 1)
    else:
        kernel = tuple(map(int, node.weight.shape[2:]))
        dilation = whole_numbers(name, "dilation", node.dilation, axes, 1)
    stride = whole_numbers(name, "stride", node.stride, axes, 1)
    if isinstance(node.padding, str):
        around = _padding(name, node.padding, kernel, stride, dilation)
    else:
        around = tuple((n, n) for n in whole_numbers(name, "padding", node.padding, axes, 0))
    return ConvWindow(kernel, stride, around, dilation)


def _padding(
    name: str, padding: str, kernel: Shape, stride: Shape, dilation: Shape
) -> tuple[tuple[int, int], ...]:
    """Zeros before and after each axis for "valid" or "same"; the odd one goes after."""
    if padding == "valid":
        return tuple((0, 0) for _ in kernel)
    if padding != "same":
        found = f"padding is {padding[:20]!r}; it must be 'same', 'valid' or whole numbers"
        raise node_error(name, found)
    if max(stride) > 1:
        found = f"padding 'same' with stride {stride} differs between tools"
        raise node_error(name, found, "Write the padding as whole numbers.")
    total = [d * (k - 1) for k, d in zip(kernel, dilation, strict=True)]
    return tuple((n // 2, n - n // 2) for n in total)


# (taken, put out) of each node
Shapes: TypeAlias = dict[str, tuple[Shape, Shape]]


def shape_of(node: nir.NIRNode) -> Shape:
    """Shape that a node puts out."""
    return tuple(int(n) for n in node.output_type["output"])


def infer_shapes(graph: nir.NIRGraph) -> None:
    """Write its shapes into every node; ArtifactError where those along an edge disagree."""
    shapes = _shapes(graph)
    _check_work(graph, shapes)
    for source, target in sorted(graph.edges):
        puts, takes = shapes[source][1], shapes[target][0]
        if puts != takes:
            raise ArtifactError(
                f"edge {source!r} -> {target!r}: the shapes of the graph disagree: {source!r} puts "
                f"out {puts}, {target!r} takes {takes}. {_remedy(graph.nodes[target], takes, puts)}"
            )
    for name, (takes, puts) in shapes.items():
        node = graph.nodes[name]
        node.input_type = {"input": np.array(takes)}
        node.output_type = {"output": np.array(puts)}
        if isinstance(node, CONVOLUTIONS) and node.input_shape is None:
            node.input_shape = takes[1:] if isinstance(node, nir.Conv2d) else takes[1]


def _remedy(node: nir.NIRNode, takes: Shape, puts: Shape) -> str:
    if isinstance(node, ELEMENTWISE) and len(takes) < len(puts) and puts[: len(takes)] == takes:
        ones = ", ".join(map(str, (*takes, *(1 for _ in puts[len(takes) :]))))
        return f"If its parameters are those of channels, give them the shape ({ones})."
    return "Correct one of the two nodes."


def check_size(graph: nir.NIRGraph, size: int) -> None:
    """Raise ArtifactError where a graph is much larger than its file.

    Arrays of one value take next to nothing in a file, but not in memory. A file of megabytes may
    so ask for minutes; one that holds its numbers as they are may be of any size.

    size: of the file [bytes]
    """
    puts = {name: math.prod(map(int, n.output_type["output"])) for name, n in graph.nodes.items()}
    stateful = (*NEURONS, nir.Threshold)
    neurons = sum(puts[n] for n, node in graph.nodes.items() if isinstance(node, stateful))
    found = {"neurons": (neurons, 1 << 20, 8), "values": (sum(puts.values()), 1 << 22, 4)}
    for what, (number, free, bytes_) in found.items():
        if number > free + size // bytes_:
            raise ArtifactError(
                f"{number} {what} in a timestep; of a file of {size} bytes at most "
                f"{free + size // bytes_}. Divide the network, or write its arrays without "
                "compression: nir.write(path, graph, compression=None)."
            )


def _check_work(graph: nir.NIRGraph, shapes: Shapes) -> None:
    """Raise ArtifactError where one timestep would exhaust the memory or take minutes."""
    values = 0
    for name, (takes, puts) in sorted(shapes.items()):
        node = graph.nodes[name]
        values += math.prod(puts)
        windows = 0
        if isinstance(node, CONVOLUTIONS):
            windows = takes[0] * math.prod(puts[1:]) * math.prod(node.weight.shape[2:])
        for number, what, most in (
            (values, "values are put out here and before", MAX_VALUES),
            (multiplications(name, node, puts), "multiplications", _MAX_MULTIPLICATIONS),
            (windows, "values in its windows", _MAX_WINDOW_VALUES),
        ):
            if number > most:
                limit = f"{number} {what} in a timestep; at most {most}"
                raise node_error(name, limit, "Correct its shape, or divide the network.")


def multiplications(name: str, node: nir.NIRNode, puts: Shape) -> int:
    """Multiplications in one timestep of a node that puts out this shape; a pool's additions."""
    if isinstance(node, DENSE):
        return int(node.weight.size)
    if isinstance(node, CONVOLUTIONS):
        return int(node.weight.size) * math.prod(puts[1:])
    if isinstance(node, POOLS):
        return math.prod(puts) * math.prod(window_of(name, node).kernel)
    return math.prod(puts)


def _shapes(graph: nir.NIRGraph) -> Shapes:
    sources: dict[str, list[str]] = {name: [] for name in graph.nodes}
    targets: dict[str, list[str]] = {name: [] for name in graph.nodes}
    for source, target in graph.edges:
        sources[target].append(source)
        targets[source].append(target)
    shapes: Shapes = {}
    unknown, waiting = set(graph.nodes), sorted(graph.nodes)
    while unknown:
        new = []
        for name in waiting:
            known = [shapes[source][1] for source in sources[name] if source in shapes]
            takes = stated_shape(name, graph.nodes[name]) or (known[0] if known else None)
            if takes is not None:
                shapes[name] = takes, output_shape(name, graph.nodes[name], takes)
                new.append(name)
        unknown.difference_update(new)
        waiting = sorted({target for name in new for target in targets[name]} & unknown)
        if unknown and not waiting:
            found = "its shape is not known, as no edge from a node with a known shape leads to it"
            raise node_error(min(unknown), found, "Connect it to the input, or remove it.")
    return shapes


def stated_shape(name: str, node: nir.NIRNode) -> Shape | None:
    """The input shape that a node's own fields fix, or None where they leave it open."""
    if isinstance(node, POOLS):
        return None
    if isinstance(node, CONVOLUTIONS):
        if node.input_shape is None:
            return None
        axes = 1 if isinstance(node, nir.Conv1d) else 2
        extents = whole_numbers(name, "input_shape", node.input_shape, axes, 1)
        return _channels(node), *extents
    if isinstance(node, DENSE):
        return tuple(map(int, (*node.weight.shape[:-2], node.weight.shape[-1])))
    if isinstance(node, (nir.Input, nir.Output, nir.Flatten)):
        stated = node.input_type["input"]
        if stated is None:
            return None
        return whole_numbers(name, "shape", np.asarray(stated), np.size(stated), 1)
    return parameter_shape(node)


def parameter_shape(node: nir.NIRNode) -> Shape:
    """The shape of the parameters of a node with one for each value."""
    fields = {nir.Scale: "scale", nir.Threshold: "threshold", nir.Delay: "delay"}
    return tuple(map(int, np.shape(getattr(node, fields.get(type(node), "r")))))


def _channels(node: nir.NIRNode) -> int:
    return int(node.weight.shape[1]) * int(node.groups)


def output_shape(name: str, node: nir.NIRNode, takes: Shape) -> Shape:
    """Shape that a node puts out for what it takes; ArtifactError where it cannot take that."""
    _check_values(name, takes)
    if isinstance(node, DENSE):
        return *takes[:-1], int(node.weight.shape[-2])
    if isinstance(node, (*CONVOLUTIONS, *POOLS)):
        return _window_output_shape(name, node, takes)
    if isinstance(node, nir.Flatten):
        return flattened_shape(name, node, takes)
    return takes


def _check_values(name: str, shape: Shape) -> None:
    if math.prod(shape) > MAX_VALUES:
        raise node_error(name, f"{shape} is more than {MAX_VALUES} values")


def _window_output_shape(name: str, node: nir.NIRNode, takes: Shape) -> Shape:
    """The output shape of a convolution or pool; ArtifactError where its kernel does not fit."""
    axes = ("C", "L") if isinstance(node, nir.Conv1d) else ("C", "H", "W")
    if len(takes) != len(axes):
        raise node_error(name, f"{takes} arrives, but it takes ({', '.join(axes)})")
    features = takes[0]
    if isinstance(node, CONVOLUTIONS):
        features = int(node.weight.shape[0])
        if takes[0] != _channels(node):
            groups = f"{node.weight.shape} with {int(node.groups)} groups is for {_channels(node)}"
            raise node_error(name, f"{takes[0]} channels arrive, but the weight {groups}")
    window = window_of(name, node)
    padded, positions = window.padded(takes[1:]), window.positions(takes[1:])
    if min(positions) < 1:
        found = f"a kernel of extent {window.span} does not fit into {padded}, padding included"
        raise node_error(name, found, "Make the kernel smaller or pad more.")
    _check_values(name, padded)
    _check_values(name, positions)
    return features, *positions


def flattened_shape(name: str, node: nir.Flatten, takes: Shape) -> Shape:
    """The shape with the axes from start_dim to end_dim as one; the batch axis is not counted."""
    (start,) = whole_numbers(name, "start_dim", node.start_dim, 1, -len(takes))
    (end,) = whole_numbers(name, "end_dim", node.end_dim, 1, -len(takes))
    first, last = start % len(takes), end % len(takes)
    if max(start, end) >= len(takes) or first > last:
        found = f"axes {start} to {end} cannot be flattened in {takes}"
        raise node_error(name, found, "Correct them; the batch axis is not counted.")
    return *takes[:first], math.prod(takes[first : last + 1]), *takes[last + 1 :]


def whole_numbers(name: str, field: str, value: object, axes: int, minimum: int) -> tuple[int, ...]:
    """One integer for each axis, given for each or once for all; else ArtifactError."""
    found = np.asarray(value)
    if found.dtype.kind not in "iu" or found.shape not in {(), (1,), (axes,)} or not found.size:
        shown = str(found.tolist())[:40]
        raise node_error(name, f"{field} is {shown}; it must be whole numbers, one or {axes}")
    if found.min() < minimum:
        raise node_error(name, f"{field} holds {found.min()}; it must be {minimum} or more")
    return tuple(int(n) for n in np.broadcast_to(found, (axes,)))
