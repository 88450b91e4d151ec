"""Design rules on maps: their kernels, the values and the signs of their weights."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from runtime.design import Design
from runtime.ruling import Ruling, at_most
from runtime.shapes import DENSE
from runtime.windows import CONVOLUTIONS, convolution_window


def kernel(design: Design) -> Iterator[Ruling]:
    """Kernels and strides of convolutions."""
    limits = design.limits.convolutions
    for name, node in sorted(design.graph.nodes.items()):
        if limits is None or not isinstance(node, CONVOLUTIONS) or name in design.network.host:
            continue
        window = convolution_window(name, node)
        fits = max(window.kernel) <= limits.kernel and {*window.stride} <= {*limits.strides}
        yield Ruling(
            rule="kernel",
            node=name,
            status="pass" if fits else "fail",
            found=f"a kernel of {_by(window.kernel)}, stride {_by(window.stride)}",
            limit=f"kernels to {limits.kernel}, strides {', '.join(map(str, limits.strides))}",
            remedy="Train with such a kernel.",
        )


def weight_values(design: Design) -> Iterator[Ruling]:
    """Different weights of a neuron, where a chip has a table of few."""
    remedy = "Quantise to so few weights, or double sources so that each has one more."
    limit = design.limits.weight_values
    for name, node in sorted(design.graph.nodes.items()):
        if limit is not None and isinstance(node, DENSE) and name not in design.network.host:
            rows = node.weight.reshape(-1, node.weight.shape[-1])
            found = max(len(np.unique(row[row != 0])) for row in rows)
            yield at_most("axon-types", name, found, limit, "weights of a neuron", remedy)


def axon_signs(design: Design) -> Iterator[Ruling]:
    """Sources excite all that they reach, or inhibit all, where a chip keeps signs by source."""
    if not design.limits.axon_signs:
        return
    remedy = "Train with sources of one sign, or double them."
    for name in (*design.network.inputs, *(p.name for p in design.network.populations)):
        fans = [connection.fan for connection in design.network.leaving(name)]
        weights = [fan.weight for fan in fans if fan.weight is not None]
        if weights:
            up, down = (_any(weights, sign) for sign in (1, -1))
            found, unit = int((up & down).sum()), "sources with weights of both signs"
            yield at_most("sign", name, found, 0, unit, remedy)


def _any(weights: list[NDArray[np.float64]], sign: int) -> NDArray[np.bool_]:
    """(M,) whether a source has weights of this sign."""
    return np.asarray(np.any([(sign * weight > 0).any(axis=1) for weight in weights], axis=0))


def _by(extents: tuple[int, ...]) -> str:
    return " x ".join(map(str, extents))
