"""First-person views of corridors: rays to the walls, then signs and gates before them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from examples.kart_eye.course import (
    PERIOD,
    TEXTURE_COLUMNS,
    TEXTURE_ROWS,
    TEXTURES,
    WALL,
)
from examples.kart_eye.signs import BLURS, COLUMNS, ROWS

Floats = NDArray[np.float32]

EYE = 0.3  # height of the camera [m]
HORIZON = 0.75  # share of the picture above it: the camera looks up
_NEAR, _FAR = 0.02, 99.0  # [m]
_RATIO = np.log(BLURS[1] / BLURS[0])


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
        walls: Floats,
        planes: Floats,
        textures: Floats,
        pictures: Floats,
        which: NDArray[np.int64],
    ) -> Floats:
        """Pictures (B, rows, columns), the top row first.

        position  (B, 2) [m]
        heading   (B,) [rad]
        walls     (B, 2, SIDES, 5), planes (B, PLANES, 8) of Local
        textures  (all, TEXTURES, TEXTURE_ROWS, TEXTURE_COLUMNS)
        pictures  (all, 2 n + 3, 6, ROWS, COLUMNS)
        which     (B,) those of the scenes, of all textures and pictures
        """
        cos, sin = np.cos(heading).astype(np.float32), np.sin(heading).astype(np.float32)
        at = position.astype(np.float32)
        # rays (B, 2, columns) whose length is the depth: ahead + side * right
        ahead, right = np.stack((cos, sin), 1), np.stack((sin, -cos), 1)
        ray = ahead[..., None] + right[..., None] * self.side
        with np.errstate(divide="ignore"):
            inverse = np.float32(1) / ray
        # (B, 2, SIDES, columns)
        depth = (walls[..., 0] - at[..., None])[..., None] * inverse[:, :, None]
        along = depth * ray[:, ::-1, None]
        along += at[:, ::-1, None, None]
        hit = (depth > _NEAR) & (along >= walls[..., 1, None]) & (along <= walls[..., 2, None])
        depth[~hit] = _FAR
        count, columns = len(heading), len(self.side)
        depth, along = (each.reshape(count, -1, columns) for each in (depth, along))
        first = depth.argmin(1)[:, None]
        depth = np.take_along_axis(depth, first, 1)[:, 0]
        along = np.take_along_axis(along, first, 1)[:, 0]
        looks = walls.reshape(count, -1, walls.shape[-1])[
            np.arange(count)[:, None], first[:, 0], 3:
        ]
        turns = (along + looks[..., 1]) * np.float32(TEXTURE_COLUMNS / PERIOD)
        start = looks[..., 0].astype(np.int32) + which[:, None].astype(np.int32) * TEXTURES
        start *= TEXTURE_ROWS * TEXTURE_COLUMNS
        start += turns.astype(np.int32) % TEXTURE_COLUMNS
        grain = np.float32((TEXTURE_ROWS - 2) / WALL)
        row = depth[:, None] * (self.slope[:, None] * grain)
        row += np.float32(EYE * grain + 1)
        np.clip(row, 0, TEXTURE_ROWS - 1, out=row)
        index = row.astype(np.int32)
        index *= TEXTURE_COLUMNS
        index += start[:, None]
        seen: Floats = textures.reshape(-1).take(index)
        self._draw_planes(seen, depth, at, ray, inverse, planes, pictures, which)
        return seen

    def _draw_planes(
        self,
        seen: Floats,
        depth: Floats,
        at: Floats,
        ray: Floats,
        inverse: Floats,
        planes: Floats,
        pictures: Floats,
        which: NDArray[np.int64],
    ) -> None:
        """Draw signs and gates that are before the walls into `seen`."""
        planes = planes[:, (planes[..., 7] >= 0).any(0)]
        axis = planes[..., 0].astype(np.int64)  # (B, k)
        each = np.arange(len(seen))[:, None]
        # (B, k, columns)
        far = (planes[..., 1] - at[each, axis])[..., None] * inverse[each, axis]
        across = far * ray[each, 1 - axis]
        across += (at[each, 1 - axis] - planes[..., 2])[..., None]
        shown = (far > 4 * _NEAR) & (far < depth[:, None]) & (planes[..., 7, None] >= 0)
        shown &= np.abs(across) < planes[..., 4, None]
        env, plane, column = np.nonzero(shown)
        if not len(env):
            return
        far, across = far[shown], across[shown]
        _, _, _, right, half, low, high, picture = planes[env, plane].T
        u = ((across * right / half + 1) * np.float32(0.5 * COLUMNS)).astype(np.int64)
        blur = np.log(far * np.float32(self._pixel / BLURS[0])) / np.float32(_RATIO)
        level = np.clip(np.rint(blur), 0, len(BLURS) - 1).astype(np.int64)
        begins = (which[env] * pictures.shape[1] + picture.astype(np.int64)) * len(BLURS) + level
        begins = begins * (ROWS * COLUMNS) + np.clip(u, 0, COLUMNS - 1)
        # rows of the picture (entries, rows), counted down from the upper edge
        scale = ROWS / (high - low)
        down = ((high - EYE) * scale)[:, None] - (far * scale)[:, None] * self.slope
        place = np.flatnonzero((down >= 0) & (down < ROWS))
        entry, row = np.divmod(place, len(self.slope))
        texel = begins[entry] + down.reshape(-1)[place].astype(np.int64) * COLUMNS
        seen[env[entry], row, column[entry]] = pictures.reshape(-1)[texel]
