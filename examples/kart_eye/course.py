"""Courses: corridors that end in a T, one arm of which is open, with signs, gates and textures.

Corridor k runs from the middle of fork k - 1 to the middle of fork k; the open arm of a fork is the
next corridor, and the other arm looks the same. Overlaps of far corridors do not matter, since only
what can be seen from a corridor is drawn there. Lengths are in metres; in a corridor x points to
the right and y ahead, from the middle of the fork behind.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from examples.kart_eye.signs import COLUMNS, HEIGHT, ROWS, WIDTH, Signs, draw_board

Floats = NDArray[np.float64]

HALF = 1.2  # half width of a corridor [m]
WALL = 2.0  # height of the walls [m]
LENGTHS = (5.5, 7.0)  # [m]
SIGN_AFTER = (2.8, 3.2)  # of a corridor's first sign, from the middle of the fork behind [m]
SIGN_BEFORE = (0.0, 0.4)  # of its second, before the middle of the fork ahead [m]
SIGN_ABOVE = (0.5, 0.75)  # lower edge of a sign above the floor [m]
SIGN_ASIDE = 0.25  # of a sign from the middle [m], to either side
GATE_AT = 2.6  # of a gate, from the middle of the fork behind [m]
GATE_BAR = (0.25, 0.45)  # heights of a closed gate [m]
UNSEEN_SEEDS = 5_000  # from which signs are of other hands than those of training

TEXTURES = 4  # of an episode
TEXTURE_ROWS, TEXTURE_COLUMNS = 34, 256  # first row floor, last row sky
PERIOD = 8.0  # [m] after which a texture repeats
_FLOOR, _SKY = -0.5, 0.7  # log luminance
_WAVES = 6

SIDES = 8  # walls across each axis of the world, padded
PLANES = 9  # signs and gates that can be seen from a corridor


@dataclass(frozen=True)
class Local:
    """What can be seen from one corridor, in the world's coordinates.

    walls    (2, SIDES, 5) across axis 0 and axis 1: where it stands, lowest and highest of the
             other coordinate, texture, phase [m]; NaN walls are none
    planes   (PLANES, 8): axis, where it stands, middle of the other coordinate, its direction to
             the right of the picture, half width, lower and upper edge [m], picture (-1: none)
    """

    walls: Floats
    planes: Floats


@dataclass(frozen=True)
class Course:
    """The course of one episode of n forks.

    arm       (n,) +1 where the right arm is open, -1 left
    length    (n + 1,) of the corridors, from middle to middle of their forks
    origin    (n + 1, 2) where each begins
    ahead     (n + 1,) direction, in quarter turns counterclockwise from the x axis
    sign      (n + 1, 2, 3) of the two signs in a corridor: x of the middle, y, lower edge
    wait      (n,) time [s] that the gate of a corridor stays closed; 0 is no gate
    pictures  (2 n + 3, 6, ROWS, COLUMNS) float32 log luminance of the signs, and of a gate
    textures  (TEXTURES, TEXTURE_ROWS, TEXTURE_COLUMNS) float32 log luminance
    local     (n,) what can be seen from each
    """

    arm: NDArray[np.int64]
    length: Floats
    origin: Floats
    ahead: NDArray[np.int64]
    sign: Floats
    wait: Floats
    pictures: NDArray[np.float32]
    textures: NDArray[np.float32]
    local: list[Local]

    @property
    def forks(self) -> int:
        """Number of forks n."""
        return len(self.arm)


def draw_course(seed: int, forks: int, signs: Signs, wait: float) -> Course:
    """The course of a seed.

    wait  mean time at each gate [s]; 0 for no gates
    """
    rng = np.random.default_rng([seed, 0])
    arm = rng.integers(0, 2, forks) * 2 - 1
    length = rng.uniform(*LENGTHS, forks + 1)
    ahead = np.cumsum(np.concatenate(([0], -arm)))
    steps = length[:-1, None] * directions(ahead[:-1])
    origin = np.concatenate((np.zeros((1, 2)), np.cumsum(steps, axis=0)))
    aside, above = (
        rng.uniform(*ends, (forks + 1, 2)) for ends in ((-SIGN_ASIDE, SIGN_ASIDE), SIGN_ABOVE)
    )
    after, before = (rng.uniform(*ends, forks + 1) for ends in (SIGN_AFTER, SIGN_BEFORE))
    sign = np.stack((aside, np.stack((after, length - before), axis=1), above), axis=-1)
    waits = wait * rng.uniform(0.5, 1.5, forks)
    said = np.concatenate((arm, rng.integers(0, 2, 1) * 2 - 1))
    unseen = seed >= UNSEEN_SEEDS
    boards = [draw_board(rng, signs, int(each), unseen) for each in said.repeat(2)]
    pictures = np.stack([*boards, _stripes()])
    textures = _draw_textures(rng)
    made = Course(arm, length, origin, ahead, sign, waits, pictures, textures, [])
    looks: Floats = np.stack(
        (rng.integers(0, TEXTURES, (forks + 3, 3)), rng.uniform(0, PERIOD, (forks + 3, 3))), -1
    )
    made.local.extend(_local(made, k, looks) for k in range(forks))
    return made


def directions(ahead: NDArray[np.int64]) -> Floats:
    """Unit vectors (…, 2) of quarter turns (…)."""
    return np.array([(1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0)])[ahead % 4]


def _local(course: Course, k: int, looks: Floats) -> Local:
    """What can be seen from corridor k.

    looks  (n + 3, 3, 2) texture and phase of the end, the right and the left near wall of fork
           k - 1, k, …: one row before the first
    """
    w, length, after = HALF, course.length[k], course.length[k + 1]
    before, end, beyond = looks[k], looks[k + 1], looks[k + 2]
    side = int(course.arm[k - 1]) if k else 1
    near = (1, 2)[::side]  # the near walls of the fork behind: of the arm taken, of the other
    along, across = [], []  # walls of constant x, of constant y
    along.append((-side * w, -after if k else -w, length - w, before[0]))
    along.append((side * w, w if k else -w, length - w, before[near[0]]))
    if k:
        old, older = course.length[k - 1], looks[k - 1]
        was = int(course.arm[k - 2]) if k > 1 else 1
        sides = {-was: older[0], was: older[(1, 2)[::was][0]]}  # of the old corridor, by its own x
        low, high = sorted((side * w, side * old))
        across += [(side * x * w, low, high, sides[x]) for x in (-1, 1)]  # the old x is side * y
        along.append((side * w, -course.length[k], -w, before[near[1]]))
        across.append((-course.length[k] - w, -w, w, end[0]))
    else:
        across.append((-w, -w, w, before[0]))
    across.append((length + w, -after - w, after + w, end[0]))
    across.append((length - w, w, after - w, end[1]))
    across.append((length - w, -after + w, -w, end[2]))
    along += [(x * (after + w), length - w - 4, length + w + 4, beyond[0]) for x in (-1, 1)]
    walls = np.full((2, SIDES, 5), np.nan)
    walls[..., 3:] = 0
    axis = int(course.ahead[k]) % 2  # of y: 0 where the corridor runs along the world's x
    for local, rows in ((0, along), (1, across)):
        for place, (at, low, high, look) in enumerate(rows):
            point = np.array([[at, low], [at, high]])
            ends = to_world(course, k, point if local == 0 else point[:, ::-1])
            fixed = 1 - axis if local == 0 else axis
            low, high = sorted(ends[:, 1 - fixed].tolist())
            walls[fixed, place] = ends[0, fixed], low, high, *look
    return Local(walls, _planes(course, k))


def _planes(course: Course, k: int) -> Floats:
    """Signs and gates (PLANES, 8) that can be seen from corridor k, the farthest first."""
    length, gate = course.length[k], len(course.pictures) - 1 if course.wait.any() else -1
    next_gate = gate if k + 1 < course.forks else -1
    arms = (1, -1)  # in an arm, x is s * (length - y) here
    rows = []
    for place in (1, 0):
        x, y, low = course.sign[k + 1, place].tolist()
        edges, picture = (low, low + HEIGHT), 2 * (k + 1) + place
        rows += [((s * y, length - s * x), (0, -s), WIDTH / 2, edges, picture) for s in arms]
    rows += [((s * GATE_AT, length), (0, -s), HALF, GATE_BAR, next_gate) for s in arms]
    for place in (1, 0):
        x, y, low = course.sign[k, place].tolist()
        rows.append(((x, y), (1, 0), WIDTH / 2, (low, low + HEIGHT), 2 * k + place))
    rows.append(((0, GATE_AT), (1, 0), HALF, GATE_BAR, gate))
    planes = np.empty((PLANES, 8))
    for place, (middle, right, half, heights, picture) in enumerate(rows):
        at, tip = to_world(course, k, np.array([middle, np.add(middle, right)]))
        other = int(np.argmax(np.abs(tip - at)))
        planes[place] = (
            1 - other,
            at[1 - other],
            at[other],
            np.sign((tip - at)[other]),
            half,
            *heights,
            picture,
        )
    return planes


def to_world(course: Course, k: int, points: Floats) -> Floats:
    """Points (…, 2) of corridor k in the world."""
    forward = directions(course.ahead[k])
    right = np.array([forward[1], -forward[0]])
    found: Floats = course.origin[k] + points[..., :1] * right + points[..., 1:] * forward
    return found


def _draw_textures(rng: np.random.Generator) -> NDArray[np.float32]:
    """Smooth sums of waves, periodic along the wall."""
    u = np.arange(TEXTURE_COLUMNS) * (2 * math.pi / TEXTURE_COLUMNS)
    v = (np.arange(TEXTURE_ROWS - 2) + 0.5) * (2 * math.pi * WALL / PERIOD / (TEXTURE_ROWS - 2))
    shape = (TEXTURES, _WAVES, 1, 1)
    turns = rng.integers(2, 11, shape) * rng.choice((-1, 1), shape)
    rises = rng.uniform(0, 8, shape)
    phase, share = rng.uniform(0, 2 * math.pi, shape), rng.uniform(0.5, 1, shape)
    waves = share * np.cos(turns * u + rises * v[:, None] + phase)
    contrast, level = (
        rng.uniform(0.08, 0.25, (TEXTURES, 1, 1)),
        rng.uniform(-0.2, 0.2, (TEXTURES, 1, 1)),
    )
    found = np.empty((TEXTURES, TEXTURE_ROWS, TEXTURE_COLUMNS), np.float32)
    found[:, 1:-1] = level + contrast * waves.sum(1) / math.sqrt(_WAVES / 2)
    found[:, 0], found[:, -1] = _FLOOR, _SKY
    return found


def _stripes() -> NDArray[np.float32]:
    """The picture of a gate's bar, the same at all levels."""
    x = np.arange(COLUMNS) * (2 * math.pi * 5 / COLUMNS)
    row = np.clip(2 * np.sin(x), -1, 1).astype(np.float32)
    return np.broadcast_to(row, (6, ROWS, COLUMNS)).astype(np.float32)
