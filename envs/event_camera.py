"""An event camera: from frames of light to events, by the pixel model of v2e.

v2e: Hu, Liu and Delbruck, "v2e: From Video Frames to Realistic DVS Events", CVPR workshops 2021,
and its code, github.com/SensorsINI/v2e at commit b0ae3bcb, v2ecore/emulator.py and
emulator_utils.py. A pixel remembers the logarithm of the light at its last event. When the
logarithm has moved by a threshold it sends an event, ON for a rise and OFF for a fall, and
remembers the new value. docs/event-camera.md has the equations and what is not modelled.

Everything is computed for B cameras at once, and without a loop over pixels. A camera of a batch
gives the same bits as that camera alone.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from spikedeploy.runtime.camera_events import EVENT, Events
from spikedeploy.runtime.errors import EnvError

Float32 = NDArray[np.float32]
Places = NDArray[np.intp]

LINEAR_UP_TO = 20.0  # luminance below which pixels are linear (v2e, lin_log)
_LEAST_THRESHOLD = 0.01  # of a pixel (v2e, _init)
_DARK, _RANGE = 20.0, 275.0  # a relative intensity is (luminance + 20) / 275 (v2e)
_NOISE_IN_LIGHT = 0.25  # rate of shot noise at full intensity, of that in darkness (v2e)


@dataclass(frozen=True)
class CameraParameters:
    """Parameters of the pixels, with v2e's names in brackets.

    on_threshold: change of ln(light) that makes an ON event (pos_thres)
    off_threshold: change that makes an OFF event (neg_thres)
    mismatch: standard deviation of the thresholds of pixels (sigma_thres)
    cutoff_hz: bandwidth of the photoreceptor in full light [Hz]; 0 for none (cutoff_hz)
    leak_hz: rate of ON events by leakage, of a pixel [Hz] (leak_rate_hz)
    leak_jitter: its deviation from frame to frame, as a share (leak_jitter_fraction)
    leak_mismatch: its deviation between pixels [decades] (noise_rate_cov_decades)
    shot_noise_hz: rate of noise events of a dark pixel [Hz] (shot_noise_rate_hz)
    refractory_s: shortest time between two events of a pixel [s] (refractory_period_s)
    """

    on_threshold: float = 0.2
    off_threshold: float = 0.2
    mismatch: float = 0.03
    cutoff_hz: float = 0.0
    leak_hz: float = 0.0
    leak_jitter: float = 0.0
    leak_mismatch: float = 0.0
    shot_noise_hz: float = 0.0
    refractory_s: float = 0.0

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            least = _LEAST_THRESHOLD if field.name.endswith("_threshold") else 0.0
            if not (isinstance(value, int | float) and least <= value < math.inf):
                raise EnvError(f"camera: {field.name} is {value!r}; give a number from {least:g}")


# v2e: "clean" and "noisy" as in EventEmulator.set_dvs_params; "v2e" are the defaults of its command
# line, v2ecore/v2e_args.py, for good light
PRESETS: Mapping[str, CameraParameters] = {
    "clean": CameraParameters(mismatch=0.02),
    "noisy": CameraParameters(
        mismatch=0.05, cutoff_hz=30.0, leak_hz=0.1, leak_jitter=0.1, leak_mismatch=0.1,
        shot_noise_hz=5.0,
    ),
    "v2e": CameraParameters(
        mismatch=0.03, cutoff_hz=300.0, leak_hz=0.01, leak_jitter=0.1, leak_mismatch=0.1,
        shot_noise_hz=0.001, refractory_s=0.0005,
    ),
}  # fmt: skip


def camera_parameters(given: str | Mapping[str, float] | CameraParameters) -> CameraParameters:
    """Return the parameters of a preset, or the defaults with fields replaced by name."""
    if isinstance(given, CameraParameters):
        return given
    if isinstance(given, str):
        if given not in PRESETS:
            raise EnvError(f"camera: no preset {given!r}; there are {', '.join(PRESETS)}")
        return PRESETS[given]
    known = [field.name for field in fields(CameraParameters)]
    if unknown := [name for name in given if name not in known]:
        raise EnvError(f"camera: no parameter {unknown[0]!r}; there are {', '.join(known)}")
    return CameraParameters(**given)


def lin_log(luminance: ArrayLike) -> Float32:
    """Logarithm of luminances 0 to 255 of any shape, linear below 20.

    y = x ln(20) / 20 up to 20, ln(x) above; rounded to 8 digits (v2e, lin_log).
    """
    light = np.asarray(luminance)
    if light.dtype == np.uint8:
        logarithms: Float32 = _table()[light]
        return logarithms
    light = light.astype(np.float64)
    logarithm = np.log(np.maximum(light, LINEAR_UP_TO))
    slope = math.log(LINEAR_UP_TO) / LINEAR_UP_TO
    mapped = np.where(light <= LINEAR_UP_TO, light * slope, logarithm)
    return np.asarray(mapped.round(8), np.float32)


@cache
def _table() -> Float32:
    return lin_log(np.arange(256.0))


def _luminance(logarithm: NDArray[Any]) -> NDArray[np.float64]:
    """Inverse of lin_log."""
    linear = np.asarray(logarithm, np.float64) * (LINEAR_UP_TO / math.log(LINEAR_UP_TO))
    return np.where(linear <= LINEAR_UP_TO, linear, np.exp(logarithm, dtype=np.float64))


@dataclass(frozen=True)
class _FrameEvents:
    """Events of all cameras in a frame, without an order.

    place: (E,) index into the pixels of all cameras
    is_on: (E,) polarity
    turn: (E,) n of the n-th time of the frame, from 1
    turns: (B,) how many times the frame has; noise stands at the last
    """

    place: Places
    is_on: NDArray[np.bool_]
    turn: NDArray[np.int64]
    turns: NDArray[np.int64]


class EventCamera:
    """B event cameras that look at frames, or one.

    shape: (H, W) [pixels], of one camera; (B, H, W) of several
    parameters: of the pixels: a preset's name, fields by name, or CameraParameters
    seeds: of the mismatch and noise; one for each camera
    is_log: True if frames are values of lin_log already (v2e's --hdr)

    A frame has luminances from 0 to 255, in any type. The first one after a reset sets the memory
    of the pixels and makes no events.
    """

    def __init__(
        self,
        shape: Sequence[int],
        parameters: str | Mapping[str, float] | CameraParameters = "clean",
        seeds: int | Sequence[int] = 0,
        *,
        is_log: bool = False,
    ) -> None:
        if len(shape) not in (2, 3) or not all(
            isinstance(each, int | np.integer) and 0 < each <= 1 << 16 for each in shape
        ):
            raise EnvError(
                f"camera: a shape of {tuple(shape)}; give (H, W), or (B, H, W) for several "
                "cameras, each from 1 to 65,536"
            )
        self.shape = tuple(int(each) for each in shape)
        self.parameters = camera_parameters(parameters)
        self.is_log = is_log
        self._batch = self.shape[0] if len(shape) == 3 else 1
        self._size = self.shape[-2] * self.shape[-1]
        pixels = (self._batch, self._size)
        self._on, self._off, self._leak, self._memory, self._light = (
            np.zeros(pixels, np.float32) for _ in range(5)
        )
        self._difference = np.zeros(pixels, np.float32)
        self._last = np.zeros(pixels)  # time of the last event [s]
        self._now = np.zeros(self._batch)  # time of the last frame [s]
        self._has_begun = np.zeros(self._batch, np.bool_)
        self._noise = [np.random.default_rng()] * self._batch
        self._order = [np.random.default_rng()] * self._batch
        self._noise_of = [np.zeros(0)] * self._batch
        self.reset(seeds)

    def reset(self, seeds: int | Sequence[int], cameras: Sequence[int] | None = None) -> None:
        """Begin again with new pixels; the next frame makes no events.

        seeds: one for each camera
        cameras: those that begin again; all where it is None
        """
        chosen = range(self._batch) if cameras is None else cameras
        given = [seeds] if isinstance(seeds, int | np.integer) else list(seeds)
        if len(given) != len(chosen):
            raise EnvError(f"camera: {len(given)} seeds for {len(chosen)} cameras")
        p = self.parameters
        for camera, seed in zip(chosen, given, strict=True):
            # apart, so that events and counts of a frame leave the noise of the next as it is
            pattern, self._noise[camera], self._order[camera] = (
                np.random.default_rng([int(seed), stream]) for stream in range(3)
            )
            # theta = max(N(nominal, mismatch), 0.01)
            drawn = pattern.standard_normal((2, self._size))
            nominal = np.array([[p.on_threshold], [p.off_threshold]])
            thresholds = np.maximum(nominal + p.mismatch * drawn, _LEAST_THRESHOLD)
            self._on[camera], self._off[camera] = thresholds
            # rate = leak 10^(mismatch N(0, 1)); a rate of 1 Hz moves by one threshold in a second
            rate = p.leak_hz * 10.0 ** (p.leak_mismatch * pattern.standard_normal(self._size))
            self._leak[camera] = rate * thresholds[0]
            # noise is the more frequent the lower a threshold is: rate / 2 nominal / theta
            self._noise_of[camera] = np.cumsum(p.shot_noise_hz / 2.0 * nominal / thresholds)
            self._last[camera] = -math.inf
            self._has_begun[camera] = False

    def process(self, frames: ArrayLike, t: ArrayLike) -> Any:  # noqa: ANN401
        """Events of frames up to their time, in the order of time.

        frames: (H, W) or (B, H, W), as the camera's shape
        t: [s] when they were taken, later than the last; (B,) or one for all

        Returns events (E,) of type EVENT, or B of them for cameras in a batch. The n-th of k
        times between two frames is n / k of the way, where k is the most events of a pixel of
        that camera (v2e); noise has the last. Events of one time are in random order.
        """
        before, fired = self._now.copy(), self._fire(frames, t)
        found = [self._events(camera, before[camera], fired) for camera in range(self._batch)]
        return found if len(self.shape) == 3 else found[0]

    def count(self, frames: ArrayLike, t: ArrayLike, counts: NDArray[Any]) -> None:
        """Add the number of events to counts ([B,] 2, H, W): first ON, then OFF events.

        The cameras are afterwards as after `process` of the same frames.
        """
        expected = (*self.shape[:-2], 2, *self.shape[-2:])
        if counts.shape != expected:
            raise EnvError(f"camera: counts of shape {counts.shape}; give {expected}")
        fired = self._fire(frames, t)
        camera, pixel = np.divmod(fired.place, self._size)
        row, column = np.divmod(pixel, self.shape[-1])
        channel = np.where(fired.is_on, 0, 1)
        np.add.at(counts.reshape(self._batch, *expected[-3:]), (camera, channel, row, column), 1)

    def _fire(self, frames: ArrayLike, t: ArrayLike) -> _FrameEvents:
        """Events of a frame; the state after them."""
        given = np.asarray(frames)
        if given.shape != self.shape:
            raise EnvError(f"camera: a frame of shape {given.shape}; it has {self.shape}")
        given = given.reshape(self._batch, self._size)
        now = np.broadcast_to(np.asarray(t, np.float64), (self._batch,)).copy()
        elapsed = np.where(self._has_begun, now - self._now, 0.0)
        if not (np.isfinite(now) & ((elapsed > 0.0) | ~self._has_begun)).all():
            raise EnvError(
                f"camera: frames at {now.tolist()} s; each must be later than that camera's last, "
                f"at {self._now.tolist()} s"
            )
        self._light = self._photoreceptor(given, elapsed)
        if not self._has_begun.all():
            fresh = ~self._has_begun
            self._memory[fresh] = self._light[fresh]
            self._has_begun[fresh] = True
        self._leak_memory(elapsed)
        places, is_on, each = self._changes()
        turns = np.ones(self._batch, np.int64)
        np.maximum.at(turns, places // self._size, each)
        place, on, turn = self._signal(places, is_on, each, turns, elapsed)
        noise = self._shot_noise(given, elapsed)
        self._memory.reshape(-1)[noise[0]] = self._light.reshape(-1)[noise[0]]
        self._now = now
        return _FrameEvents(
            np.concatenate([place, noise[0]]),
            np.concatenate([on, noise[1]]),
            np.concatenate([turn, turns[noise[0] // self._size]]),
            turns,
        )

    def _photoreceptor(self, given: NDArray[Any], elapsed: NDArray[np.float64]) -> Float32:
        """Output (B, H W) of the photoreceptor: the logarithm, with its bandwidth."""
        light = given.astype(np.float32) if self.is_log else lin_log(given)
        if not self.parameters.cutoff_hz:
            return light
        # y += min(1, I 2 pi f dt) (x - y), which is slower in the dark
        rate = (2.0 * math.pi * self.parameters.cutoff_hz * elapsed).astype(np.float32)
        share = np.minimum(self._intensity(given) * rate[:, None], np.float32(1.0))
        passed = self._light + share * (light - self._light)
        return np.where(self._has_begun[:, None], passed, light)

    def _intensity(self, given: NDArray[Any]) -> Float32:
        """Relative intensity, from 20 / 275 in darkness to 1 in white (v2e)."""
        light = _luminance(given) if self.is_log else given
        return ((light + _DARK) / _RANGE).astype(np.float32)

    def _leak_memory(self, elapsed: NDArray[np.float64]) -> None:
        """Leakage of the memories, which makes ON events: m -= dt rate theta (1 - j N(0, 1))."""
        if not self.parameters.leak_hz:
            return
        change = self._leak * elapsed[:, None].astype(np.float32)
        if jitter := np.float32(self.parameters.leak_jitter):
            for camera, rng in enumerate(self._noise):
                if elapsed[camera] > 0.0:
                    change[camera] *= 1 - jitter * rng.standard_normal(self._size, np.float32)
        self._memory -= change

    def _changes(self) -> tuple[Places, NDArray[np.bool_], NDArray[np.int64]]:
        """Places (K,) of pixels that saw a change, their polarity, and by how many thresholds."""
        difference = np.subtract(self._light, self._memory, out=self._difference)
        is_quiet = (difference < self._on) & (difference > -self._off)
        places = np.flatnonzero(~is_quiet)
        change = difference.reshape(-1)[places]
        if not np.isfinite(change).all():
            raise EnvError("camera: a frame has numbers that are infinite or none")
        is_on = change > 0.0
        each = np.abs(change) / self._threshold(places, is_on)
        return places, is_on, np.floor(each).astype(np.int64)

    def _threshold(self, places: Places, is_on: NDArray[np.bool_]) -> Float32:
        threshold: Float32 = np.where(
            is_on, self._on.reshape(-1)[places], self._off.reshape(-1)[places]
        )
        return threshold

    def _signal(
        self,
        places: Places,
        is_on: NDArray[np.bool_],
        each: NDArray[np.int64],
        turns: NDArray[np.int64],
        elapsed: NDArray[np.float64],
    ) -> tuple[Places, NDArray[np.bool_], NDArray[np.int64]]:
        """Events of changes: place, polarity and turn (E,); pixels remember what they have sent."""
        source = np.repeat(np.arange(len(places)), each)
        turn = np.arange(len(source)) - np.repeat(np.cumsum(each) - each, each) + 1
        if self.parameters.refractory_s and len(source):
            is_sent = self._past_refractory(places, source, turn, turns, elapsed)
            source, turn = source[is_sent], turn[is_sent]
            each = np.bincount(source, minlength=len(places))
        # m += n theta_on, m -= n theta_off
        moved = each.astype(np.float32) * self._threshold(places, is_on)
        self._memory.reshape(-1)[places] += np.where(is_on, moved, -moved)
        return places[source], is_on[source], turn

    def _past_refractory(
        self,
        places: Places,
        source: Places,
        turn: NDArray[np.int64],
        turns: NDArray[np.int64],
        elapsed: NDArray[np.float64],
    ) -> NDArray[np.bool_]:
        """Return (E,) whether an event is late enough after the last that its pixel sent."""
        camera = places[source] // self._size
        time = self._now[camera] + elapsed[camera] * turn / turns[camera]
        last = self._last.reshape(-1)
        is_sent = np.zeros(len(source), np.bool_)
        for each in range(1, int(turn.max()) + 1):
            (at,) = np.nonzero(turn == each)
            pixel = places[source[at]]
            is_sent[at] = time[at] - last[pixel] >= self.parameters.refractory_s
            last[pixel] = np.where(is_sent[at], time[at], last[pixel])
        return is_sent

    def _shot_noise(
        self, given: NDArray[Any], elapsed: NDArray[np.float64]
    ) -> tuple[Places, NDArray[np.bool_]]:
        """Noise events: place and polarity (E,).

        A Poisson process for each pixel and polarity, with v2e's rate of
        shot_noise_hz / 2 nominal / theta (1 - 0.75 I). Drawn by thinning (Lewis and Shedler
        1979): as many as darkness would have, of which the light keeps some, so that it costs
        no draw for every pixel, as v2e makes.
        """
        if not self.parameters.shot_noise_hz:
            return np.zeros(0, np.intp), np.zeros(0, np.bool_)
        entries, kept = [], []
        for camera, rng in enumerate(self._noise):
            rates = self._noise_of[camera]  # cumulative, of ON and then of OFF events
            which, keep = rng.random((2, rng.poisson(rates[-1] * elapsed[camera])))
            found = rates.searchsorted(which * rates[-1], "right")
            entries.append(np.minimum(found, len(rates) - 1) + 2 * self._size * camera)
            kept.append(keep)
        channel, pixel = np.divmod(np.concatenate(entries), self._size)
        place = channel // 2 * self._size + pixel
        rate = 1.0 - (1.0 - _NOISE_IN_LIGHT) * self._intensity(given.reshape(-1)[place])
        is_kept = np.concatenate(kept) < rate
        return place[is_kept], channel[is_kept] % 2 == 0

    def _events(self, camera: int, before: float, fired: _FrameEvents) -> Events:
        """Events (E,) of a camera in the order of time."""
        (at,) = np.nonzero(fired.place // self._size == camera)
        shuffled = self._order[camera].permutation(at)
        chosen = shuffled[np.argsort(fired.turn[shuffled], kind="stable")]
        row, column = np.divmod(fired.place[chosen] % self._size, self.shape[-1])
        share = fired.turn[chosen] / fired.turns[camera]
        events = np.empty(len(chosen), EVENT)
        events["x"], events["y"] = column, row
        events["t"] = np.rint((before + (self._now[camera] - before) * share) * 1e6)
        events["p"] = fired.is_on[chosen]
        return events
