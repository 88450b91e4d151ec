"""A LIDAR that measures badly, and tyres that slip: options of the karts."""

from __future__ import annotations

from dataclasses import asdict, is_dataclass
from typing import Any

from spikedeploy.envs.disturbances.kind import KART, Change, Defaults, Kind, Options


def _lidar(field: str) -> Change:
    """What sets an option of the LIDAR; the others stay as they are given."""

    def change(options: Options, number: float, default: Defaults, world: str) -> Options:
        given: Any = options.get("lidar") or {}
        before = asdict(given) if is_dataclass(given) and not isinstance(given, type) else given
        return {**options, "lidar": {**before, field: number}}

    return change


def _slipping(options: Options, number: float, default: Defaults, world: str) -> Options:
    before: float = options["grip"] if "grip" in options else default("grip")
    return {**options, "grip": before * (1.0 - number)}


LIDAR_NOISE = Kind(
    meaning="white noise on every distance of the LIDAR",
    unit="px, standard deviation",
    levels={KART: (20.0, 50.0, 100.0)},
    bounds=(0.0, 1000.0),
    source="6, 14 and 29 % of a range of 350 px: 0.2 to 1 m at 100 px to a metre, far "
    "above the centimetres of a good LIDAR",
    change=_lidar("noise"),
)
LIDAR_DROPOUT = Kind(
    meaning="rays of the LIDAR that see no wall",
    unit="probability of each ray, a control step",
    levels={KART: (0.05, 0.1, 0.2)},
    bounds=(0.0, 1.0),
    source="chosen: dark and shining walls return few pulses",
    change=_lidar("dropout"),
)
GRIP = Kind(
    meaning="tyres that slip: a change of velocity comes slower",
    unit="share of each change that is lost, a control step",
    levels={KART: (0.8, 0.9, 0.95)},
    bounds=(0.0, 0.99),
    source="chosen: velocity follows the wheels with time constants of about 75, 158 and 325 ms",
    change=_slipping,
)
