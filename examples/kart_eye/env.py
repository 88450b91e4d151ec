"""One kart of EyeBatch as a gymnasium environment."""

from __future__ import annotations

import math
from typing import Any, ClassVar

import gymnasium
import numpy as np
from numpy.typing import NDArray

from examples.kart_eye.batch import STEERING, EyeBatch, EyeOptions

Floats = NDArray[np.float64]

_FADING = 0.04  # [s] in which events fade from a picture
_WIDTH = 0.12  # of the bell around the teacher's steering [full steering]


class KartEye(gymnasium.Env[Floats, Any]):
    """Drive by signs that an event camera sees, to where six forks have been passed.

    render_mode  "rgb_array" or None
    options      those of EyeOptions, by name

    Observed are the numbers of events in the control step, in the order of EyeOptions.counted:
    polarity, row, column. An action chooses one of STEERING; the kart keeps its speed, but for
    gates, at which it waits by itself. An episode ends after the last fork (terminated, a success),
    in a wrong arm or at a wall (terminated), or when its time is over (truncated).
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 60}  # noqa: RUF012
    CONTROL_DT = 1.0 / EyeOptions.rate  # [s]
    ACTIONS: ClassVar[tuple[str, ...]] = (
        "left", "half left", "slightly left", "straight", "slightly right", "half right", "right",
    )  # fmt: skip

    def __init__(self, *, render_mode: str | None = None, **options: Any) -> None:  # noqa: ANN401
        self.render_mode = render_mode
        self.options = EyeOptions(**options)
        self.CONTROL_DT = 1.0 / self.options.rate
        self.batch = EyeBatch(1, self.options)
        size = math.prod(self.options.counted)
        self.observation_space = gymnasium.spaces.Box(0.0, 255.0, (size,), np.float64)
        self.action_space: gymnasium.Space[Any] = gymnasium.spaces.Discrete(len(STEERING))
        self.recent = np.zeros((2, *self.options.shape))  # events of each pixel, fading
        self.trail: list[tuple[float, float]] = []  # [m] where the kart has been

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Floats, dict[str, Any]]:
        """Begin an episode in the course of the seed."""
        super().reset(seed=seed)
        drawn = int(self.np_random.integers(2**31)) if seed is None else seed
        counts = self.batch.reset([drawn])
        self.recent[:] = 0.0
        self.trail = [(float(self.batch.x[0]), float(self.batch.y[0]))]
        return counts.reshape(-1).astype(np.float64), {}

    def step(self, action: Any) -> tuple[Floats, float, bool, bool, dict[str, Any]]:  # noqa: ANN401
        """Advance by one control step."""
        batch = self.batch
        counts, reward, terminated, truncated, info = batch.step(np.array([action]))
        if self.render_mode is not None:
            self.recent *= math.exp(-self.CONTROL_DT / _FADING)
            self.recent += batch.pixels[0]
            self.trail.append((float(batch.x[0]), float(batch.y[0])))
        first = {name: values[0].item() for name, values in info.items()}
        first |= {"success": first["finish"], "speed": float(batch.speed[0])}
        ends = bool(terminated[0]), bool(truncated[0])
        return counts.reshape(-1).astype(np.float64), float(reward[0]), *ends, first

    def expert(self) -> Floats:
        """Logits (7,) of what the teacher would do now, who knows the way: a bell around it."""
        apart = (self.batch.teacher()[0] - np.array(STEERING)) / _WIDTH
        return np.asarray(-0.5 * apart**2)

    def render(self) -> NDArray[np.uint8]:
        """A picture (720, 960, 3): the view, the events, the map."""
        from examples.kart_eye.picture import picture

        return picture(self)
