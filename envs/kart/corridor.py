"""Random corridors of square cells, drawn anew at every reset."""

from __future__ import annotations

import re
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from spikedeploy.envs.errors import EnvError
from spikedeploy.envs.kart.track import Track, segments

FloatArray = NDArray[np.float64]
Cell = tuple[int, int]

_HALF = 50.0  # [px] half a cell's side, as in kart-simulator
_CENTRE = (500.0, 500.0)  # [px] of the first cell
_SPREAD = 25.0  # [px] of start positions within it
_NAME = re.compile(r"corridor(?:-(\d+))?$")
_LENGTHS = (2, 64)  # cells
_DIRECTIONS: tuple[Cell, ...] = ((1, 0), (0, 1), (-1, 0), (0, -1))  # right, down, left, up


def length_of(name: str) -> int | None:
    """Cells of `corridor` (3, as in kart-simulator) or `corridor-N`; None for other names."""
    match = _NAME.match(name)
    if match is None:
        return None
    count = int(match[1] or 3)
    if not _LENGTHS[0] <= count <= _LENGTHS[1]:
        raise EnvError(f"track {name!r}: a corridor has {_LENGTHS[0]} to {_LENGTHS[1]} cells")
    return count


def corridor(count: int, rng: np.random.Generator) -> Track:
    """A corridor of `count` cells that does not touch itself; its far end is the finish."""
    path = _path(count, rng)
    steps = [(b[0] - a[0], b[1] - a[1]) for a, b in pairwise(path)]
    # a cell is open towards its predecessor and its successor, the last one towards the finish
    entered: list[set[Cell]] = [set(), *({(-dx, -dy)} for dx, dy in steps)]
    left = [*steps, steps[-1]]
    openings = [before | {after} for before, after in zip(entered, left, strict=True)]
    polylines = tuple(
        _side(cell, side)
        for cell, open_sides in zip(path, openings, strict=True)
        for side in _DIRECTIONS
        if side not in open_sides
    )
    heading = float(np.arctan2(steps[0][1], steps[0][0]))
    return Track(
        name=f"corridor-{count}",
        walls=segments(polylines),
        gates=np.stack([_side(cell, step) for cell, step in zip(path, left, strict=True)]),
        start=np.array(_CENTRE),
        spread=_SPREAD,
        heading=(heading, heading),
        polylines=polylines,
    )


def _path(count: int, rng: np.random.Generator) -> list[Cell]:
    """Cells of a random walk, each beside no earlier cell except its predecessor."""
    while True:
        path: list[Cell] = [(0, 0)]
        while len(path) < count:
            choices = [cell for cell in _beside(path[-1]) if _is_free(cell, path)]
            if not choices:
                break  # a dead end: start again
            path.append(choices[int(rng.integers(len(choices)))])
        if len(path) == count:
            return path


def _beside(cell: Cell) -> list[Cell]:
    return [(cell[0] + dx, cell[1] + dy) for dx, dy in _DIRECTIONS]


def _is_free(cell: Cell, path: list[Cell]) -> bool:
    return cell not in path and not any(other in path[:-1] for other in _beside(cell))


def _side(cell: Cell, side: Cell) -> FloatArray:
    """Edge (2, 2) of a cell on one of its sides [px]."""
    middle = np.array(_CENTRE) + 2 * _HALF * np.array(cell) + _HALF * np.array(side)
    along = _HALF * np.array([side[1], side[0]])
    edge: FloatArray = np.stack([middle - along, middle + along])
    return edge
