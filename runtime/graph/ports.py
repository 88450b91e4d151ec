"""The ports of a graph, its Input and Output nodes, and their rasters side by side as one.

The compiled program has one input of M spike trains, whatever the number and shapes of the ports.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
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
    shape: of its values in a timestep.
    """

    name: str
    shape: tuple[int, ...]

    @cached_property
    def size(self) -> int:
        """Values in a timestep."""
        return math.prod(self.shape)


def ports(nodes: Mapping[str, nir.NIRNode]) -> tuple[Port, ...]:
    """The ports of Input or Output nodes, sorted by name."""
    return tuple(
        Port(name, tuple(int(n) for n in nodes[name].output_type["output"]))
        for name in sorted(nodes)
    )


def by_port(all_: Sequence[Port], rasters: Rows | Mapping[str, Rows]) -> dict[str, Rows]:
    """Return the raster (B, T, *shape) of each port by name; a single port needs no name.

    That of a single port may also be (B, T, M), in C order, as a codec encodes it.

    Raises ObservationError where names or shapes do not fit the ports.
    """
    if isinstance(rasters, Mapping):
        given = dict(rasters)
    elif len(all_) == 1:
        (port,) = all_
        is_flat = rasters.shape[2:] == (port.size,)
        given = {port.name: split(all_, rasters)[port.name] if is_flat else rasters}
    else:
        raise ObservationError(f"one raster without a name is given. {_inputs(all_)}")
    _check_rasters(all_, given)
    return given


def _inputs(all_: Sequence[Port]) -> str:
    names = ", ".join(port.name for port in all_)
    return f"The network has the inputs {names}: give one raster for each, by name."


def check_unmasked(raster: object) -> None:
    """Raise ObservationError where a raster has masked values."""
    if isinstance(raster, np.ma.MaskedArray) and np.ma.getmaskarray(raster).any():
        raise ObservationError(
            "the raster has masked values, which nothing says what to do with. Fill them, such as "
            "with raster.filled(0)."
        )


def concatenate(all_: Sequence[Port], rows: Mapping[str, Rows]) -> Rows:
    """Join the rasters (B, T, *shape) of ports, sorted by name, into one (B, T, M) in C order."""
    _check_rasters(all_, rows)
    flat = [rows[port.name].reshape(*rows[port.name].shape[:2], port.size) for port in all_]
    return flat[0] if len(flat) == 1 else np.concatenate(flat, axis=2)


def split(all_: Sequence[Port], rows: Rows) -> dict[str, Rows]:
    """The raster (B, T, *shape) of each port, from that of all (B, T, M): undoes `concatenate`."""
    ends = np.cumsum([port.size for port in all_])[:-1]
    return {
        port.name: part.reshape(*part.shape[:2], *port.shape)
        for port, part in zip(all_, np.split(rows, ends, axis=2), strict=True)
    }


def _check_rasters(all_: Sequence[Port], rows: Mapping[str, Rows]) -> None:
    """Raise ObservationError where the rasters (B, T, *shape) do not fit the ports."""
    if names := sorted({port.name for port in all_} ^ set(rows)):
        raise ObservationError(f"{names[0]!r} has no match. {_inputs(all_)}")
    leading = rows[all_[0].name].shape[:2]
    for port in all_:
        found = rows[port.name]
        if found.ndim < 2 or found.shape[2:] != port.shape or not found.size:
            wanted = ", ".join(["B", "T", *map(str, port.shape)])
            raise ObservationError(
                f"the raster has shape {found.shape} with its batch; node {port.name!r} takes "
                f"({wanted}), B inferences of at least one timestep. Give the raster of this "
                "network."
            )
        if found.shape[:2] != leading:
            raise ObservationError(
                f"the raster of node {port.name!r} has (B, T) = {found.shape[:2]}, that of another "
                f"input {leading}. Give all rasters the same batch and timesteps."
            )
