"""What a kind of disturbance is."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import gymnasium

Options = dict[str, Any]
Defaults = Callable[[str], Any]  # name of an option of the environment -> its default
Change = Callable[[Options, float, Defaults, str], Options]
Wrap = Callable[[gymnasium.Env[Any, Any], float], gymnasium.Env[Any, Any]]

HEXAPOD, KART = "hexapod", "kart"  # worlds: folders of envs
FOREIGN = "foreign"  # environments of other people


@dataclass(frozen=True)
class Kind:
    """A kind of disturbance; it changes options of an environment, or wraps it.

    meaning  what happens, in a clause
    unit     of its number
    levels   world -> numbers of levels 1, 2 and 3; worlds without it are left out
    bounds   (lowest, highest) number that may be given
    source   where the levels come from
    change   options with the disturbance, of (options, number, defaults, world)
    wrap     the environment with the disturbance, of (environment, number)
    """

    meaning: str
    unit: str
    levels: Mapping[str, tuple[float, float, float]]
    bounds: tuple[float, float]
    source: str
    change: Change | None = None
    wrap: Wrap | None = None
