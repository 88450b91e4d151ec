"""An event camera for any gymnasium environment that renders.

`EventCameraWrapper(gymnasium.make("CartPole-v1", render_mode="rgb_array"))` observes counts of
events in place of the state. `envs.make(name, event_camera={...})` puts it on environments of other
people, as `--set event_camera.frames=4` does on the command line.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from functools import lru_cache
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium.spaces import Box
from numpy.typing import NDArray

from spikedeploy.envs.event_camera import CameraParameters, EventCamera, Float32, lin_log
from spikedeploy.runtime.camera_events import EVENT, Events, EventWriter, write_events
from spikedeploy.runtime.errors import EnvError

_LUMA = np.array([0.299, 0.587, 0.114], np.float32)  # of R, G, B (ITU-R BT.601, as v2e by OpenCV)
_MOST_COUNTED = 2**16 - 1
_STREAM = 12  # keeps the draws apart from those of environments and disturbances with the seed


def control_period(env: gymnasium.Env[Any, Any]) -> float | None:
    """Time of a control step [s]: CONTROL_DT or dt of the environment, else 1 / render_fps."""
    world: Any = env.unwrapped
    rate = env.metadata.get("render_fps")
    choices = (getattr(world, "CONTROL_DT", None), getattr(world, "dt", None), rate and 1.0 / rate)
    return next((float(t) for t in choices if isinstance(t, int | float) and t > 0), None)


class EventCameraWrapper(gymnasium.Wrapper[Any, Any, Any, Any]):
    """An environment that is seen by an event camera.

    Observation (2, H, W) uint16: how many ON and OFF events each pixel sent in the control step.
    The info has "events" (E,), of type camera_events.EVENT, in the order of time, which runs
    on over episodes. After a reset the camera has new pixels, drawn from its seed, and no events.

    env: made with render_mode="rgb_array"
    size: (H, W) of the camera [pixels]; pictures are averaged over each pixel's area
    parameters: of the pixels: "clean", "noisy", "v2e", or fields of CameraParameters by name
    frames: pictures in a control step. Environments of gymnasium on MuJoCo render between the
        steps of their physics. For others the logarithms of the pictures before and after
        the step are interpolated linearly, which gives events times and the photoreceptor
        its bandwidth, but shows nothing that happened in between
    dt: [s] of a control step; None if the environment knows it
    record: HDF5 file for all events, in its place after close(); None for none
    """

    def __init__(
        self,
        env: gymnasium.Env[Any, Any],
        size: tuple[int, int] = (32, 64),
        parameters: str | Mapping[str, float] | CameraParameters = "clean",
        frames: int = 1,
        *,
        dt: float | None = None,
        record: str | Path | None = None,
    ) -> None:
        super().__init__(env)
        if len(size) != 2:
            raise EnvError(f"camera: a size of {size}; give (H, W)")
        if not isinstance(frames, int) or frames < 1:
            raise EnvError(f"camera: {frames} frames in a control step; give a whole number from 1")
        period = control_period(env) if dt is None else dt
        if period is None:
            raise EnvError("camera: the environment has no time of a control step; give dt [s]")
        if env.render_mode != "rgb_array":
            raise EnvError(
                f"camera: the environment renders {env.render_mode}; make it with "
                'render_mode="rgb_array"'
            )
        # gymnasium's environments on MuJoCo step their physics here
        self._simulate = getattr(env.unwrapped, "do_simulation", None)
        steps = getattr(env.unwrapped, "frame_skip", frames)
        if self._simulate is not None and frames > steps:
            raise EnvError(
                f"camera: {frames} frames in a control step, which has {steps} steps of the "
                f"physics; give at most {steps}"
            )
        self._frames, self._dt = frames, float(period)
        self._size = (int(size[0]), int(size[1]))
        self._seen = EventCamera(self._size, parameters, is_log=True)
        self._rng = np.random.default_rng()
        self._steps = 0  # control steps of all episodes
        self._before = np.zeros(self._size, np.float32)  # the latest picture, as logarithms
        self.observation_space = Box(0, _MOST_COUNTED, (2, *self._size), np.uint16)
        self._open = ExitStack()
        self._writer: EventWriter | None = None
        if record is not None:
            name = env.spec.id if env.spec else type(env.unwrapped).__name__
            remark = f"{name} through an event camera, {self._seen.parameters}"
            file = write_events(Path(record), self._size, remark)
            self._writer = self._open.enter_context(file)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Start an episode with new pixels, without events."""
        if seed is not None:
            self._rng = np.random.default_rng([seed, _STREAM])
        _, info = self.env.reset(seed=seed, options=options)
        self._seen.reset(int(self._rng.integers(2**32)))
        self._before = self._picture()
        self._seen.process(self._before, self._steps * self._dt)
        none = np.empty(0, EVENT)
        return self._count(none), {**info, "events": none}

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:  # noqa: ANN401
        """Take an action; count the events until the next."""
        found: list[Events] = []
        with self._rendering(found):
            _, reward, terminated, truncated, info = self.env.step(action)
        if not found:
            after = self._picture()
            for n in range(1, self._frames + 1):
                share = np.float32(n / self._frames)
                self._see(self._before + share * (after - self._before), n, found)
            self._before = after
        self._steps += 1
        events = np.concatenate(found)
        if self._writer is not None:
            self._writer.write(events)
        seen, ends = self._count(events), (bool(terminated), bool(truncated))
        return seen, reward, *ends, {**info, "events": events}

    def close(self) -> None:
        """Close the environment; put the recording in its place."""
        self._open.close()
        super().close()

    @contextmanager
    def _rendering(self, found: list[Events]) -> Iterator[None]:
        """Let the environment render between the steps of its physics, where it can."""
        world: Any = self.env.unwrapped
        simulate: Callable[[Any, int], None] | None = self._simulate
        if simulate is None or self._frames == 1:
            yield
            return

        def simulate_and_see(control: Any, steps: int) -> None:  # noqa: ANN401
            for n in range(1, self._frames + 1):
                # the same steps of the physics, one after the other, in as many parts
                simulate(control, steps * n // self._frames - steps * (n - 1) // self._frames)
                self._see(self._picture(), n, found)

        world.do_simulation = simulate_and_see
        try:
            yield
        finally:
            del world.do_simulation

    def _see(self, picture: Float32, n: int, found: list[Events]) -> None:
        """Append the events of the n-th picture of a control step."""
        found.append(self._seen.process(picture, (self._steps + n / self._frames) * self._dt))

    def _picture(self) -> Float32:
        """Return the logarithms (H, W) of the current picture."""
        shown: Any = self.env.render()
        if not (isinstance(shown, np.ndarray) and shown.ndim == 3 and shown.shape[2] >= 3):
            found = getattr(shown, "shape", type(shown).__name__)
            raise EnvError(f"camera: render() gave {found}; it must give a picture (H, W, 3)")
        return lin_log(average(shown[..., :3] @ _LUMA, self._size))

    def _count(self, events: Events) -> NDArray[np.uint16]:
        counts = np.zeros((2, *self._size), np.uint16)
        np.add.at(counts, (1 - events["p"].astype(np.intp), events["y"], events["x"]), 1)
        return counts


def average(picture: NDArray[Any], size: tuple[int, ...]) -> NDArray[Any]:
    """Mean of a picture (h, w) over the area of each pixel of another size (H, W)."""
    (rows, columns), (height, width) = picture.shape, size
    averaged: NDArray[Any] = _shares(height, rows) @ picture @ _shares(width, columns).T
    return averaged


@lru_cache(16)
def _shares(fewer: int, many: int) -> Float32:
    """Share (fewer, many) that each of many pixels in a row has of the fewer that cover it."""
    edges = np.arange(fewer + 1)[:, None] * many / fewer
    covered = np.clip(edges - np.arange(many), 0.0, 1.0)
    return (np.diff(covered, axis=0) * fewer / many).astype(np.float32)
