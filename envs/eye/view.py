"""First-person views of corridors: rays to the walls, then signs and gates before them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from spikedeploy.envs.eye.course import (
    PERIOD,
    TEXTURE_COLUMNS,
    TEXTURE_ROWS,
    TEXTURES,
    WALL,
)
from spikedeploy.envs.eye.signs import BLURS, COLUMNS, ROWS

Floats = NDArray[np.float32]

EYE = 0.3  # height of the camera [m]
HORIZON = 0.75  # share of the picture above it: the camera looks up
_NEAR = 0.02  # [m]


class View:
    """Pictures of B scenes, each by a pinhole camera of 90 degrees.

    shape  (rows, columns) of a picture
    slope  (rows,) rise of the ray of a row for each metre ahead
    side   (columns,) likewise to the right
    """

    def __init__(self, shape: tuple[int, int]) -> None:
        rows, columns = self.shape = shape
        focal = columns / 2
        self.slope = ((HORIZON * rows - np.arange(rows) - 0.5) / focal).astype(np.float32)
        self.side = ((np.arange(columns) + 0.5) / focal - 1).astype(np.float32)
        self._pixel = 1 / focal  # [m] at a distance of 1 m

    def log_luminance(
        self,
        position: NDArray[np.float64],
        heading: NDArray[np.float64],
        walls: NDArray[np.float64],
        planes: NDArray[np.float64],
        textures: Floats,
        pictures: Floats,
        which: NDArray[np.int64],
    ) -> Floats:
        """Pictures (B, rows, columns), the top row first.

        position  (B, 2) [m]
        heading   (B,) [rad]
        walls     (B, 2, SIDES, 6), planes (B, PLANES, 8) of Local
        textures  (all, TEXTURES, TEXTURE_ROWS, TEXTURE_COLUMNS)
        pictures  (all, n + 2, 6, ROWS, COLUMNS)
        which     (B,) those of the scenes, of all textures and pictures
        """
        count, columns = len(heading), self.shape[1]
        cos, sin = np.cos(heading).astype(np.float32), np.sin(heading).astype(np.float32)
        # rays (2, B, columns) whose length is the depth: ahead + side * right
        ray = np.stack(
            (cos[:, None] + sin[:, None] * self.side, sin[:, None] - cos[:, None] * self.side)
        )
        with np.errstate(divide="ignore"):
            step = np.float32(1) / ray
        depth = np.full((count, columns), 99.0, np.float32)
        start = np.zeros((count, columns), np.int64)  # of the texture's column
        each = np.arange(count)[:, None]
        for axis in (0, 1):
            at = walls[:, axis].transpose(2, 0, 1)[..., None]  # (6, B, SIDES, 1)
            here = position[:, axis, None, None]
            other = position[:, 1 - axis, None, None].astype(np.float32)
            far = (at[0] - here).astype(np.float32) * step[axis][:, None]
            along = other + far * ray[1 - axis][:, None]
            hit = (far > _NEAR) & (along >= at[1]) & (along <= at[2])
            far = np.where(hit, far, np.float32(99.0))
            first = far.argmin(1)
            nearest = np.take_along_axis(far, first[:, None], 1)[:, 0]
            closer = nearest < depth
            depth = np.where(closer, nearest, depth)
            where = np.take_along_axis(along, first[:, None], 1)[:, 0] + walls[each, axis, first, 4]
            column = (where * np.float32(TEXTURE_COLUMNS / PERIOD)).astype(
                np.int64
            ) % TEXTURE_COLUMNS
            texture = walls[each, axis, first, 3].astype(np.int64) + which[:, None] * TEXTURES
            begins = texture * (TEXTURE_ROWS * TEXTURE_COLUMNS) + column
            start = np.where(closer, begins, start)
        grain = np.float32((TEXTURE_ROWS - 2) / WALL)
        row = depth[:, None] * (self.slope[:, None] * grain)
        row += np.float32(EYE * grain + 1)
        np.clip(row, 0, TEXTURE_ROWS - 1, out=row)
        index = row.astype(np.int32)
        index *= TEXTURE_COLUMNS
        index += start.astype(np.int32)[:, None]
        seen: Floats = textures.reshape(-1).take(index)
        self._draw_planes(seen, depth, position, ray, step, planes, pictures, which)
        return seen

    def _draw_planes(
        self,
        seen: Floats,
        depth: Floats,
        position: NDArray[np.float64],
        ray: Floats,
        step: Floats,
        planes: NDArray[np.float64],
        pictures: Floats,
        which: NDArray[np.int64],
    ) -> None:
        """Draw signs and gates that are before the walls into `seen`."""
        each = np.arange(len(seen))[:, None]
        axis = planes[..., 0].astype(np.int64)  # (B, PLANES)
        # (B, PLANES, columns)
        inverse = step[axis, each]
        far = (planes[..., 1] - position[each, axis])[..., None].astype(np.float32) * inverse
        other = (position[each, 1 - axis] - planes[..., 2])[..., None].astype(np.float32)
        across = (other + far * ray[1 - axis, each]) * planes[..., 3, None]
        shown = (far > 4 * _NEAR) & (far < depth[:, None]) & (planes[..., 7, None] >= 0)
        shown &= np.abs(across) < planes[..., 4, None]
        env, plane, column = np.nonzero(shown)
        if not len(env):
            return
        far, across = far[shown], across[shown]
        half, low, high, picture = planes[env, plane, 4:].T
        u = ((across / half + 1) * np.float32(0.5 * COLUMNS)).astype(np.int64)
        blur = np.log(far * np.float32(self._pixel / BLURS[0])) / np.float32(
            np.log(BLURS[1] / BLURS[0])
        )
        level = np.clip(np.rint(blur), 0, len(BLURS) - 1).astype(np.int64)
        begins = (
            (which[env] * pictures.shape[1] + picture.astype(np.int64)) * len(BLURS) + level
        ) * (ROWS * COLUMNS)
        begins += np.clip(u, 0, COLUMNS - 1)
        # rows of the picture (entries, rows), counted down from the upper edge
        down = (high - EYE)[:, None] - far[:, None] * self.slope
        down *= (ROWS / (high - low))[:, None]
        entry, row = np.nonzero((down >= 0) & (down < ROWS))
        place = begins[entry] + down[entry, row].astype(np.int64) * COLUMNS
        seen[env[entry], row, column[entry]] = pictures.reshape(-1).take(place)
