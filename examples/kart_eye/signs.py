"""Signs over the forks: letters as they are or mirrored, or chevrons, as pictures at six distances.

A letter as it is means right, a mirrored one left; chevrons point. Letters are strokes of a few
hands: proportions, slant and width are drawn for each sign, and those of evaluation come from hands
of their own, whose ranges overlap those of training.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]
Points = NDArray[np.float64]
Signs = Literal["letters", "chevrons"]

TEXEL = 0.02  # [m]
ROWS, COLUMNS = 30, 92  # texels of a board: 0.60 m by 1.84 m
HEIGHT, WIDTH = ROWS * TEXEL, COLUMNS * TEXEL  # [m]
BLURS = 0.03 * 1.3 ** np.arange(6)  # [m] footprint of a pixel at which each picture is sharp
LETTERS = "FRJ4"
_WORD = 4  # letters
_PITCH = 0.42  # of letters [m]
_ASIDE = 0.03  # of a letter from its place [m], to either side
_BORDER = 0.04  # [m]
_FRAME = 0.5  # log luminance by which the border is darker than the board


@dataclass(frozen=True)
class Hand:
    """A way of writing, from which the form of a sign is drawn.

    tall    height of a letter [m], lowest and highest; likewise
    wide    width / height
    stroke  width of a stroke / height
    slant   shear: sideways / height, of either sign
    waist   height of a middle bar / height
    serif   length of a serif / height
    round   exponent of the superellipse of a bowl: 2 is an ellipse
    """

    tall: tuple[float, float]
    wide: tuple[float, float]
    stroke: tuple[float, float]
    slant: tuple[float, float]
    waist: tuple[float, float]
    serif: tuple[float, float]
    round: tuple[float, float]


_TRAINING = (
    Hand((0.34, 0.38), (0.60, 0.78), (0.12, 0.17), (0.0, 0.13), (0.46, 0.56), (0.0, 0.0), (2, 3)),
    Hand((0.34, 0.38), (0.60, 0.80), (0.12, 0.16), (0.0, 0.10), (0.48, 0.58), (0.1, 0.2), (2, 3)),
)
_UNSEEN = (
    Hand((0.34, 0.38), (0.58, 0.66), (0.14, 0.18), (0.05, 0.15), (0.45, 0.54), (0.0, 0.0), (3, 4)),
    Hand((0.35, 0.38), (0.62, 0.78), (0.12, 0.15), (0.0, 0.10), (0.47, 0.57), (0.04, 0.1), (2, 3)),
)


@dataclass(frozen=True)
class Form:
    """The form of one letter, drawn from a hand; fields as there, a number each."""

    tall: float
    wide: float
    stroke: float
    slant: float
    waist: float
    serif: float
    round: float


def draw_form(rng: np.random.Generator, unseen: bool) -> Form:
    """The form of a sign; `unseen` takes the hands of evaluation."""
    hands = _UNSEEN if unseen else _TRAINING
    hand = hands[int(rng.integers(len(hands)))]
    values = {name: float(rng.uniform(*ends)) for name, ends in vars(hand).items()}
    values["slant"] *= 1 if rng.random() < 0.5 else -1
    return Form(**values)


def strokes(letter: str, form: Form) -> list[Points]:
    """Lines (n, 2) of a letter in a box of height 1 and width 1, x to the right, y up."""
    w, s = form.waist, form.serif

    def bowl(x: float, low: float, high: float, first: float, last: float) -> Points:
        """Part of a superellipse, from angle to angle [quarter turns]."""
        angle = np.linspace(first, last, 9) * np.pi / 2
        power = 2.0 / form.round
        cos, sin = np.cos(angle), np.sin(angle)
        across = np.sign(cos) * np.abs(cos) ** power
        up = np.sign(sin) * np.abs(sin) ** power
        middle, half = (low + high) / 2, (high - low) / 2
        return np.stack((x + (1 - x) * across, middle + half * up), axis=1)

    def foot(x: float, y: float) -> list[Points]:
        return [_line((x - s, y), (x + s, y))] if s > 0 else []

    if letter == "F":
        bars = [_line((0, 1), (1, 1)), _line((0, w), (0.8, w))]
        return [_line((0, 0), (0, 1)), *bars, *foot(0, 0)]
    if letter == "R":
        top = [_line((0, 1), (0.5, 1)), bowl(0.5, w, 1, 1, -1), _line((0.5, w), (0, w))]
        return [_line((0, 0), (0, 1)), *top, _line((0.45, w), (1, 0)), *foot(0, 0)]
    if letter == "J":
        hook = bowl(0.5, 0, 0.7, 0, -2)
        return [_line((1, 1), (1, 0.35)), hook, *foot(1, 1), _line((0.45, 1), (1, 1))]
    if letter == "4":
        low = w - 0.16
        return [_line((0.75, 0), (0.75, 1), (0, low), (1, low)), *foot(0.75, 0)]
    raise ValueError(letter)


def _line(*points: tuple[float, float]) -> Points:
    return np.array(points, np.float64)


def draw_board(rng: np.random.Generator, signs: Signs, arm: int, unseen: bool) -> Floats:
    """The sign that says which arm is open, +1 right, -1 left, blurred by BLURS, top row first.

    Returns (6, ROWS, COLUMNS) log luminance above the board's.
    """
    form = draw_form(rng, unseen)
    low = float(rng.uniform(0.3, 0.6))
    room = HEIGHT - (1 + form.stroke) * form.tall - 2 * _BORDER
    picture = np.zeros((ROWS, COLUMNS))
    half = form.stroke * form.tall / 2
    reach = (form.wide / 2 * (1 + 2 * form.serif) + abs(form.slant) / 2) * form.tall + half
    for place in range(_WORD):
        lines = strokes(LETTERS[int(rng.integers(len(LETTERS)))], form)
        if signs == "chevrons":
            lines = [_line((0.0, 0), (1.0, low), (0.0, 1))]
        lift = float(rng.uniform(-0.5, 0.5)) * room
        aside = float(rng.uniform(-1, 1)) * _ASIDE
        middle = arm * ((place - (_WORD - 1) / 2) * _PITCH + aside)
        contrast = float(rng.uniform(1.0, 1.3)) * (1 if rng.random() < 0.5 else -1)
        columns = np.flatnonzero(np.abs(_across() - middle) <= 1.3 * reach + TEXEL)
        centre = _centre(lines)
        placed = []
        for points in lines:
            x = (points[:, 0] - centre) * form.wide + form.slant * (points[:, 1] - 0.5)
            up = (points[:, 1] - 0.5) * form.tall + lift
            placed.append(np.stack((arm * x * form.tall + middle, up), axis=1))
        picture[:, columns] += contrast * _ink(placed, half, _across()[columns])
    edge = np.minimum(WIDTH / 2 - np.abs(_across()), HEIGHT / 2 - np.abs(_up())[:, None])
    frame = np.clip(0.5 + (_BORDER - edge) / TEXEL, 0, 1)
    picture -= _FRAME * frame
    levels = np.stack([rows @ picture @ columns for rows, columns in _blurs()])
    return levels.astype(np.float32)


def _centre(lines: list[Points]) -> float:
    """Mean x of the ink of a letter, which is set in the middle of its place."""
    lengths = [np.linalg.norm(np.diff(points, axis=0), axis=1) for points in lines]
    middles = [(points[1:, 0] + points[:-1, 0]) / 2 for points in lines]
    return float(np.average(np.concatenate(middles), weights=np.concatenate(lengths)))


def _across() -> Points:
    return np.asarray((np.arange(COLUMNS) + 0.5) * TEXEL - WIDTH / 2)


def _up() -> Points:
    return np.asarray(HEIGHT / 2 - (np.arange(ROWS) + 0.5) * TEXEL)


def _ink(lines: list[Points], half: float, across: Points) -> Points:
    """Share (ROWS, columns) of each texel within `half` [m] of a line, in some columns."""
    (x, y), (ends_x, ends_y) = (
        np.concatenate([line[part] for line in lines]).T for part in (np.s_[:-1], np.s_[1:])
    )
    along_x, along_y = ends_x - x, ends_y - y
    dx, dy = across[:, None] - x, _up()[:, None, None] - y
    share = (dx * along_x + dy * along_y) / np.maximum(along_x**2 + along_y**2, 1e-12)
    share = share.clip(0, 1)
    distance = np.sqrt(((dx - share * along_x) ** 2 + (dy - share * along_y) ** 2).min(-1))
    return np.asarray(np.clip(0.5 + (half - distance) / TEXEL, 0, 1))


@cache
def _blurs() -> list[tuple[Points, Points]]:
    """Matrices (ROWS, ROWS) and (COLUMNS, COLUMNS) that average over the footprint of a pixel."""
    found = []
    for width in BLURS:
        pair = []
        for count in (ROWS, COLUMNS):
            gap = (np.arange(count)[:, None] - np.arange(count)) * TEXEL
            weights = np.exp(-0.5 * (gap / (width / np.sqrt(12))) ** 2)
            pair.append(weights / weights.sum(1, keepdims=True))
        found.append((pair[0], pair[1].T))
    return found
