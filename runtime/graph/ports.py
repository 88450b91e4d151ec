"""The ports of a graph: its Input and Output nodes, side by side as the axes of one raster."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import nir
import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.errors import ObservationError

Rows = NDArray[Any]


@dataclass(frozen=True)
class Port:
    """One Input or Output node.

    name: of the node.
    shape: of what passes in a timestep.
    """

    name: str
    shape: tuple[int, ...]

    @property
    def size(self) -> int:
        """Numbers that pass in a timestep."""
        return math.prod(self.shape)


def ports(nodes: Mapping[str, nir.NIRNode]) -> tuple[Port, ...]:
    """The ports of Input or Output nodes, in the order of their names."""
    return tuple(
        Port(name, tuple(int(n) for n in nodes[name].output_type["output"]))
        for name in sorted(nodes)
    )


def named(all_: Sequence[Port], rasters: Rows | Mapping[str, Rows]) -> dict[str, Rows]:
    """The raster (B, T, *shape) of each port; a single port's needs no name."""
    if isinstance(rasters, Mapping):
        given = dict(rasters)
    elif len(all_) == 1:
        given = {all_[0].name: rasters}
    else:
        raise ObservationError(
            f"the network has the inputs {', '.join(port.name for port in all_)}, but there is one "
            "raster without a name. Give one for each, by name."
        )
    check(all_, given)
    return given


def check(all_: Sequence[Port], rows: Mapping[str, Rows]) -> None:
    """Refuse rasters (B, T, *shape) that are not those of the ports."""
    if names := sorted({port.name for port in all_} ^ set(rows)):
        raise ObservationError(
            f"the inputs of the network are {', '.join(port.name for port in all_)}, and there are "
            f"rasters for {', '.join(sorted(rows))}. Give one for each; {names[0]} has no pair."
        )
    for port in all_:
        _check(port, rows[port.name], rows[all_[0].name].shape[:2])


def joined(all_: Sequence[Port], rows: Mapping[str, Rows]) -> Rows:
    """(B, T, M) of what goes into each port (B, T, *shape), in C order and in the ports' order."""
    check(all_, rows)
    flat = [rows[port.name].reshape(*rows[port.name].shape[:2], port.size) for port in all_]
    return flat[0] if len(flat) == 1 else np.concatenate(flat, axis=2)


def parted(all_: Sequence[Port], rows: Rows) -> dict[str, Rows]:
    """What passes each port (B, T, *shape), from all of them in one (B, T, M)."""
    ends = np.cumsum([port.size for port in all_])[:-1]
    return {
        port.name: part.reshape(*part.shape[:2], *port.shape)
        for port, part in zip(all_, np.split(rows, ends, axis=2), strict=True)
    }


def _check(port: Port, rows: Rows, leading: tuple[int, ...]) -> None:
    if rows.ndim < 2 or rows.shape[2:] != port.shape or not rows.size:
        wanted = ", ".join(["B", "T", *map(str, port.shape)])
        raise ObservationError(
            f"the raster has shape {rows.shape}; node {port.name!r} takes ({wanted}), with at "
            "least one timestep. Add the missing axis or give the raster of this network."
        )
    if rows.shape[:2] != leading:
        raise ObservationError(
            f"the raster of node {port.name!r} is {rows.shape[:2]} long (B, T), that of another "
            f"input {leading}. Make all rasters equally long."
        )
