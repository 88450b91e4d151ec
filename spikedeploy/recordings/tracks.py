"""Numbers of the step infos that a page draws over time, with the commands they should follow."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikedeploy.recordings.packed import packed

Floats = NDArray[np.float64]

_OWN = {"speed": "m/s", "heading": "rad", "lateral": "m", "slip": "m/s"}
_KART = {"speed": "px/s", "progress": "of the track"}
_MOST = 4  # infos of other people's environments


def tracks(info: Mapping[str, Floats]) -> list[dict[str, Any]]:
    """Curves of step infos: `title`, `unit`, `values` (S,) and `wanted` (S,) or None."""
    if "command_turn" in info:
        turn = info["command_turn"] - info["turn_error"]
        return [
            track("speed", "m/s", info["speed"], info["command_speed"]),
            track("turn rate", "rad/s", turn, info["command_turn"]),
        ]
    units = _OWN if "slip" in info else _KART if "gates" in info else _foreign(info)
    return [track(name, unit, info[name]) for name, unit in units.items() if name in info]


def track(title: str, unit: str, values: Floats, wanted: Floats | None = None) -> dict[str, Any]:
    """A curve, and what it should follow."""
    follows = None if wanted is None else packed(wanted)
    title = title if wanted is None else f"{title}, commanded in grey"
    return {"title": title, "unit": unit, "values": packed(values), "wanted": follows}


def _foreign(info: Mapping[str, Floats]) -> dict[str, str]:
    """The first numbers of somebody else's infos that change."""
    changing = [name for name, values in info.items() if np.ptp(np.nan_to_num(values)) > 0]
    return dict.fromkeys(changing[:_MOST], "")
