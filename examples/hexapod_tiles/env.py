"""Walk straight ahead and step on no forbidden tile: the environment."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from examples.hexapod_tiles.kinematics import NEUTRAL
from spikedeploy.envs.hexapod.camera import Mark
from spikedeploy.envs.hexapod.env import (
    BODY,
    COURSE,
    LOAD,
    FloatArray,
    HexapodEnv,
    ObservationEntry,
    check,
    course_terms,
    layout,
)
from spikedeploy.envs.hexapod.robot import Field, Motion
from spikedeploy.runtime.errors import EnvError

View = Literal["around", "ahead"]

TARGET_SPEED = 0.2  # [m/s]
STRIDE = 0.25  # [action unit] change of a servo's target in a control step, at most
REACH = 2.2  # [action unit] of a servo's target from the stance, at most
AIRTIME = 4  # [control steps] in the air, after which a contact is a touchdown
_FREE = 0.42  # [m] around the start in which no tile is forbidden
_WEIGHT = 10 / 3  # of a foot on a forbidden tile, in a control step
_DISTANCE, _MISSTEPS = 2.5, 0.05  # [m] and share of touchdowns, of a success

_STEP = 0.03  # [m] between two points of a scan
GRID = 7, 5  # points of the scan of a foothold, along and across
_OVER_FEET = np.stack(
    np.meshgrid(_STEP * np.arange(-2, 5), _STEP * np.arange(-2, 3), indexing="ij"), -1
).reshape(-1, 2)  # (35, 2)
ACROSS = 23  # points of a strip, from its right to its left
_STRIP = np.stack(
    np.meshgrid(0.30 + _STEP * np.arange(6), _STEP * np.arange(-11, 12), indexing="ij"), -1
).reshape(-1, 2)  # (138, 2)

# [m] (n, 2) forward and left of the torso's centre, along its heading
SCANS: dict[View, FloatArray] = {
    "around": (NEUTRAL[:, None] + _OVER_FEET).reshape(-1, 2),
    "ahead": _STRIP,
}
_DELAY = 6  # [control steps] between two earlier rows
_MOST_DELAYS = 60
_SEEN = 1.5  # [m] from the robot, within which tiles are drawn
_MARKED = 40  # missteps that are drawn
_FORBIDDEN, _MISSTEP = (0.62, 0.16, 0.12, 1.0), (1.0, 0.85, 0.1, 1.0)  # colours
_NOISE: dict[View, float] = {"around": 0.0, "ahead": 0.02}


def entries(view: View, delays: int = 0) -> tuple[ObservationEntry, ...]:
    """Return the entries of an observation: the hexapod's, a scan, earlier rows of the strip."""
    scan = ObservationEntry("scan", len(SCANS[view]), 0.0, 1.0)
    earlier = ObservationEntry("earlier", ACROSS * delays, 0.0, 1.0)
    return (*BODY, *COURSE, LOAD, scan, *([earlier] if delays else []))


@dataclass(frozen=True)
class Tiles:
    """Squares of the ground, some of them forbidden.

    forbidden: (columns along x, rows along y)
    size: [m] of a side
    corner: [m] (x, y) of the first
    """

    forbidden: NDArray[np.bool_]
    size: float
    corner: tuple[float, float]

    @cached_property
    def centres(self) -> FloatArray:
        """Centres (n, 2) [m] of the forbidden tiles."""
        return np.asarray((np.argwhere(self.forbidden) + 0.5) * self.size + self.corner, np.float64)

    @classmethod
    def draw(cls, field: Field, size: float, share: float, rng: np.random.Generator) -> Tiles:
        """Draw forbidden tiles, a share of those of a field; none is at its start."""
        shape = math.ceil(field.length / size), math.ceil(field.width / size)
        corner = -field.length / 2, -field.width / 2
        x, y = (end + size * (np.arange(n) + 0.5) for end, n in zip(corner, shape, strict=True))
        near = np.hypot(x[:, None] - field.start[0], y - field.start[1]) < _FREE
        return cls((rng.random(shape) < share) & ~near, size, corner)

    def contain(self, points: FloatArray) -> NDArray[np.bool_]:
        """Return whether points (n, 2) [m] are forbidden; none is beyond the field."""
        place = np.floor((points - self.corner) / self.size).astype(np.int64)
        inside = np.all((place >= 0) & (place < self.forbidden.shape), axis=-1, keepdims=True)
        i, j = np.where(inside, place, 0).T
        return np.asarray(self.forbidden[i, j] & inside[:, 0])


class HexapodTiles(HexapodEnv):
    """Walk along the x axis at 0.2 m/s for 16 s on level ground, of which tiles are forbidden.

    A tile is a mark, no hole: a foot on it is penalised in every control step, and a touchdown on
    it is a misstep. Feet are therefore placed, and the gait is a clock alone.

    Action (18,) in [-1, 1], leg by leg coxa, femur, tibia: the servos hold stance + 0.6 rad x
    target, and a control step adds 0.25 x action to the target, which stays within +-2.2.

    Observation: the 77 numbers of HexapodEnv, of which `previous` is the target of the servos, and
    a scan of the ground: 1 where a tile is forbidden, 0 elsewhere. Its points move with the body
    and turn with its heading. `around` has 35 about the foothold of each leg in its stance, 6 cm
    behind it to 12 cm before it, 6 cm to either side; `ahead` has 138 in a strip 30 to 45 cm in
    front of the body's centre and 66 cm wide, before any foot, as of a camera of depth: what the
    other legs need has to be remembered: by the policy, or by `delays`, rows of the strip nearest
    to the body as they were seen 6, 12, 18 ... control steps before (a tapped delay line, Waibel et
    al. 1989), 23 points each. 26 of them reach 62 cm back, to the rear legs. A point that is wrong,
    with the probability `noise`, is drawn anew in every control step.

    Reward of a control step: that of HexapodEnv with 0.2 m/s and without its term `jerk`, and
    -10/3 for each foot that stands on a forbidden tile. A touchdown is a contact after at least 4
    control steps in the air. An episode succeeds that does not fall, comes 2.5 m far, and whose
    missteps are at most 5 % of its touchdowns. The info adds touchdowns, missteps (so far) and
    misstep_share.

    view: "around" or "ahead"
    tile: [m] side of a tile
    share: [1] of the tiles that is forbidden
    noise: [1] probability that a point of the scan is wrong; None for 0 around, 0.02 ahead
    delays: earlier rows that are observed ahead, at most 60
    options: those of HexapodEnv
    """

    FIELD: ClassVar[Field] = Field(length=10.0, width=5.0, start=(-4.0, 0.0))
    JERK: ClassVar[float] = 0.0  # an action is a speed here

    def __init__(
        self,
        *,
        view: View = "around",
        tile: float = 0.1,
        share: float = 0.3,
        noise: float | None = None,
        delays: int = 0,
        terrain: float = 0.0,
        max_steps: int = 800,
        **options: Any,  # noqa: ANN401
    ) -> None:
        if view not in get_args(View):
            raise EnvError(f"option view: {view!r} is neither around nor ahead")
        self.view: View = view
        self._tile = _number("tile", tile, 0.02, 1.0)
        self._share = _number("share", share, 0.0, 0.9)
        self._noise = _number("noise", _NOISE[view] if noise is None else noise, 0.0, 0.5)
        if delays and view != "ahead":
            raise EnvError(
                f"option delays: view={view!r} has no rows to delay. Set delays=0 or view='ahead'"
            )
        if int(_number("delays", delays, 0, _MOST_DELAYS)) != delays:
            raise EnvError(f"option delays: {delays!r} is no whole number")
        self._delays = int(delays)
        self.ENTRIES = entries(view, self._delays)
        self.OBSERVATION = layout(self.ENTRIES)
        super().__init__(terrain=terrain, max_steps=max_steps, **options)

    @property
    def tiles(self) -> Tiles:
        """The tiles of this episode."""
        return self._tiles

    def _begin(self) -> None:
        self._tiles = Tiles.draw(self.FIELD, self._tile, self._share, self.np_random)
        self._airtime = np.zeros(6, np.int64)
        self._touchdowns = 0
        self._missed: list[tuple[int, float, float]] = []
        self._standing = np.zeros(6, np.bool_)
        self._nearest = np.zeros((1 + _DELAY * self._delays, ACROSS))  # rows, the latest first

    def _servo_command(self, action: FloatArray) -> FloatArray:
        moved: FloatArray = self._filtered + STRIDE * action
        return np.minimum(np.maximum(moved, -REACH), REACH)

    def _track(self, motion: Motion) -> None:
        super()._track(motion)
        places = self._robot.feet[:, :2]
        forbidden = self._tiles.contain(places)
        touched = motion.contact & (self._airtime >= AIRTIME)
        self._standing = motion.contact & forbidden
        self._touchdowns += int(touched.sum())
        self._missed += [(self._step, x, y) for x, y in places[touched & forbidden].tolist()]
        self._airtime = np.where(motion.contact, 0, self._airtime + 1)

    def _task_terms(self, motion: Motion) -> dict[str, float]:
        terms = course_terms(self._speed, motion.heading, motion.position[1], TARGET_SPEED)
        return {**terms, "forbidden": -_WEIGHT * float(self._standing.sum())}

    def _succeeds(self) -> bool:
        return self._distance >= _DISTANCE and self._misstep_share() <= _MISSTEPS

    def _misstep_share(self) -> float:
        return len(self._missed) / max(self._touchdowns, 1)

    def _further(self, motion: Motion) -> tuple[FloatArray, ...]:
        self._pose = motion.heading, motion.position[:2]
        seen = self._scan(self.view)
        if self._noise:
            wrong = self.np_random.random(len(seen)) < self._noise
            seen = np.where(wrong, 1.0 - seen, seen)
        if not self._delays:
            return (seen,)
        self._nearest = np.roll(self._nearest, 1, axis=0)
        self._nearest[0] = seen[:ACROSS]
        return seen, self._nearest[_DELAY::_DELAY].ravel()

    def _scan(self, view: View) -> FloatArray:
        """Return 1 where a point of a scan is forbidden (n,), 0 elsewhere, without noise."""
        heading, place = self._pose
        cosine, sine = math.cos(heading), math.sin(heading)
        turned = SCANS[view] @ np.array([[cosine, sine], [-sine, cosine]])
        return self._tiles.contain(turned + place).astype(np.float64)

    def _marks(self) -> Iterator[Mark]:
        """Forbidden tiles about the robot, and missteps."""
        tiles, here = self._tiles, np.array(self._robot.sense().position[:2])
        for centre in tiles.centres[np.hypot(*(tiles.centres - here).T) < _SEEN]:
            x, y = centre.tolist()
            yield Mark((x, y), 0.47 * tiles.size, 0.001, _FORBIDDEN)
        for _, x, y in self._missed[-_MARKED:]:
            yield Mark((x, y), 0.014, 0.002, _MISSTEP)

    def _info(self, motion: Motion, terms: dict[str, float], fall: bool) -> dict[str, Any]:
        return super()._info(motion, terms, fall) | {
            "touchdowns": self._touchdowns,
            "missteps": len(self._missed),
            "misstep_share": self._misstep_share(),
        }


class HexapodTilesAhead(HexapodTiles):
    """HexapodTiles that looks ahead, with a delay line that reaches to the rear legs.

    Its options are those of HexapodTiles; `delays=0` leaves remembering to the policy.
    """

    def __init__(self, *, view: View = "ahead", delays: int = 26, **options: Any) -> None:  # noqa: ANN401
        super().__init__(view=view, delays=delays, **options)


def _number(name: str, value: object, lowest: float, highest: float) -> float:
    number = check(name, value, lowest, highest)
    if isinstance(number, tuple):
        raise EnvError(f"option {name}: {value!r} is a pair; give one number")
    return number
