"""KartEye-v0: one kart of EyeBatch as a gymnasium environment."""

from __future__ import annotations

from typing import Any, ClassVar

import gymnasium
import numpy as np
from numpy.typing import NDArray

from spikedeploy.envs.eye.batch import STEERING, EyeBatch, EyeOptions

Floats = NDArray[np.float64]


class KartEyeEnv(gymnasium.Env[Floats, Any]):
    """Drive through forks by signs, seen by an event camera; options are those of EyeOptions.

    Observed are the event counts of the control step, flattened from EyeOptions.counted: polarity,
    rows, columns. Actions choose the steering.
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 60}  # noqa: RUF012
    STEERING: ClassVar[tuple[float, ...]] = STEERING

    def __init__(self, *, render_mode: str | None = None, **options: Any) -> None:  # noqa: ANN401
        self.options = EyeOptions(**options)
        self.CONTROL_DT = 1.0 / self.options.rate
        self.render_mode = render_mode
        self.batch = EyeBatch(1, self.options)
        size = int(np.prod(self.options.counted))
        self.OBSERVATION = {"events": slice(0, size)}
        self.observation_space = gymnasium.spaces.Box(0.0, 255.0, (size,), np.float64)
        self.action_space: gymnasium.Space[Any] = gymnasium.spaces.Discrete(len(STEERING))

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Floats, dict[str, Any]]:
        """Begin an episode in the course of the seed."""
        super().reset(seed=seed)
        drawn = int(self.np_random.integers(2**31)) if seed is None else seed
        counts = self.batch.reset([drawn])
        return counts[0].reshape(-1).astype(np.float64), {}

    def step(self, action: Any) -> tuple[Floats, float, bool, bool, dict[str, Any]]:  # noqa: ANN401
        """Advance by one control step."""
        counts, reward, terminated, truncated, info = self.batch.step(np.array([int(action)]))
        seen = counts[0].reshape(-1).astype(np.float64)
        terms = {name: float(values[0]) for name, values in info.pop("terms").items()}
        told = {name: values[0] for name, values in info.items() if values.ndim == 1}
        told |= {"success": bool(info["finish"][0]), "reward_terms": terms}
        return seen, float(reward[0]), bool(terminated[0]), bool(truncated[0]), told
