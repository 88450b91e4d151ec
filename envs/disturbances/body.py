"""Bodies and ground other than in training: options of the environments, scaled or shifted.

An option from which each episode draws keeps its draws: both ends of its range move.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from spikedeploy.envs.disturbances.kind import HEXAPOD, KART, Change, Defaults, Kind, Options


def _moved(option: str, move: Callable[[float, float], float]) -> Change:
    """What moves an option, or both ends of its range: a function of the end and the number."""

    def change(options: Options, number: float, default: Defaults, world: str) -> Options:
        value: Any = options[option] if option in options else default(option)
        if isinstance(value, (tuple, list)):
            return {**options, option: tuple(move(end, number) for end in value)}
        return {**options, option: move(value, number)}

    return change


def _less(value: float, number: float) -> float:
    return value * (1.0 - number)


def _weaker(options: Options, number: float, default: Defaults, world: str) -> Options:
    change = _moved("power" if world == KART else "servo_gain", _less)
    return change(options, number, default, world)


WEAKNESS = Kind(
    meaning="motors that are weaker: servo stiffness and damping, or a kart's power",
    unit="share that is lost",
    levels={HEXAPOD: (0.1, 0.2, 0.4), KART: (0.1, 0.2, 0.4)},
    bounds=(0.0, 0.85),
    source="motor strength down to 80 % is what Tan et al. 2018 trained for",
    change=_weaker,
)
PAYLOAD = Kind(
    meaning="a load on the torso",
    unit="kg",
    levels={HEXAPOD: (0.25, 0.5, 1.0)},
    bounds=(0.0, 1.5),
    source="10, 20 and 40 % of the robot's 2.45 kg; training draws -0.1 to 0.3 kg",
    change=_moved("payload", lambda end, number: end + number),
)
SLOPE = Kind(
    meaning="ground that rises along the x axis",
    unit="degrees",
    levels={HEXAPOD: (3.0, 6.0, 9.0)},
    bounds=(-25.0, 25.0),
    source="chosen: 9 degrees are a grade of 16 %",
    change=_moved("slope", lambda end, number: end + math.radians(number)),
)
FRICTION = Kind(
    meaning="feet that slip: less friction on the ground",
    unit="share that is lost",
    levels={HEXAPOD: (0.3, 0.5, 0.7)},
    bounds=(0.0, 0.95),
    source="coefficients of 0.39 to 0.7, 0.28 to 0.5 and 0.17 to 0.3, where training draws 0.55 "
    "to 1: the last is as wet tiles",
    change=_moved("friction", _less),
)
PUSHES = Kind(
    meaning="harder pushes, at the same times and in the same directions",
    unit="times as hard",
    levels={HEXAPOD: (1.5, 2.0, 3.0)},
    bounds=(0.0, 10.0),
    source="of kicks of 0.125 to 0.25 m/s (hexapod) and 0.25 to 0.5 m/s (hexapod-command)",
    change=_moved("pushes", lambda end, number: end * number),
)
