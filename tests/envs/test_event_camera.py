"""Event cameras: equal to a plain loop over pixels, and what v2e's model promises."""

import math

import numpy as np
import pytest

from spikedeploy.envs.event_camera import PRESETS, CameraParameters, EventCamera, lin_log
from spikedeploy.runtime.camera_events import EVENT
from spikedeploy.runtime.errors import EnvError

H, W = 5, 7
RICH = CameraParameters(0.15, 0.25, 0.04, 40.0, 3.0, 0.1, 0.1, 8.0, 0.002)


def walk(seed, steps=30, shape=(H, W), dt=0.004):
    """Frames of a random walk of the light, and their times."""
    rng = np.random.default_rng(seed)
    light = 120.0 + np.cumsum(rng.normal(0.0, 25.0, (steps, *shape)), axis=0)
    return [(np.clip(frame, 0.0, 255.0), dt * n) for n, frame in enumerate(light)]


class PlainCamera:
    """v2e's model for one camera, pixel by pixel in Python, from its paper and code.

    It takes the same draws in the same order, in single precision where the camera has it.
    """

    def __init__(self, p, seed):
        self.p, f = p, np.float32
        pattern, self.noise, _ = (np.random.default_rng([seed, n]) for n in range(3))
        draw = pattern.standard_normal((2, H * W))
        on = [max(p.on_threshold + p.mismatch * z, 0.01) for z in draw[0]]
        off = [max(p.off_threshold + p.mismatch * z, 0.01) for z in draw[1]]
        decades = pattern.standard_normal(H * W)
        self.leak = [
            f(p.leak_hz * 10.0 ** (p.leak_mismatch * z) * t)
            for z, t in zip(decades, on, strict=True)
        ]
        half = p.shot_noise_hz / 2.0
        self.rates = [half * p.on_threshold / t for t in on]
        self.rates += [half * p.off_threshold / t for t in off]
        self.on, self.off = [f(t) for t in on], [f(t) for t in off]
        self.last = [-math.inf] * (H * W)
        self.memory = self.light = None

    def look(self, frame, t):
        """Events (x, y, t [us], p) of a frame, sorted."""
        p, f, pixels = self.p, np.float32, frame.reshape(-1)
        log = [f(round(x * math.log(20) / 20 if x <= 20 else math.log(x), 8)) for x in pixels]
        if self.memory is None:
            self.memory, self.light, self.now = list(log), list(log), t
            return []
        dt, events = t - self.now, []
        intensity = [f((x + 20.0) / 275.0) for x in pixels]
        if p.cutoff_hz:
            for i in range(H * W):
                share = min(intensity[i] * f(2 * math.pi * p.cutoff_hz * dt), f(1))
                self.light[i] = self.light[i] + share * (log[i] - self.light[i])
        else:
            self.light = log
        if p.leak_hz:
            jitter = [0.0] * (H * W)
            if p.leak_jitter:
                jitter = self.noise.standard_normal(H * W, np.float32)
            for i in range(H * W):
                self.memory[i] -= self.leak[i] * f(dt) * (1 - f(p.leak_jitter) * f(jitter[i]))
        change = [a - b for a, b in zip(self.light, self.memory, strict=True)]
        many = [
            math.floor(d / self.on[i]) if d > 0 else -math.floor(-d / self.off[i])
            for i, d in enumerate(change)
        ]
        turns = max(1, *(abs(n) for n in many))
        for turn in range(1, turns + 1):
            at = self.now + dt * turn / turns
            for i in range(H * W):
                late = not p.refractory_s or at - self.last[i] >= p.refractory_s
                if abs(many[i]) >= turn and late:
                    self.last[i] = at
                    events.append((i, at, many[i] > 0))
        for i in range(H * W):
            sent = sum(place == i for place, _, _ in events)
            self.memory[i] += f(sent) * self.on[i] if many[i] > 0 else -f(sent) * self.off[i]
        if p.shot_noise_hz:
            total = np.cumsum(self.rates)
            n = self.noise.poisson(total[-1] * dt)
            for which, keep in self.noise.random((2, n)).T:
                entry = next(k for k, s in enumerate(total) if s > which * total[-1])
                i = entry % (H * W)
                if keep < 1 - 0.75 * intensity[i]:
                    events.append((i, t, entry < H * W))
                    self.memory[i] = self.light[i]
        self.now = t
        return sorted((i % W, i // W, round(at * 1e6), p) for i, at, p in events)


def plain(events):
    return sorted((int(x), int(y), int(t), bool(p)) for x, y, t, p in events.tolist())


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("parameters", [*PRESETS, RICH])
def test_events_equal_a_plain_loop_over_pixels(parameters, seed):
    camera = EventCamera((H, W), parameters, seed)
    reference = PlainCamera(camera.parameters, seed)
    total = 0
    for frame, t in walk(seed):
        events = camera.process(frame, t)
        assert plain(events) == reference.look(frame, t)
        assert events.dtype == EVENT
        assert (np.diff(events["t"]) >= 0).all()
        total += len(events)
    assert total > 100


def test_a_camera_of_a_batch_is_that_camera_alone_and_counts_are_its_events():
    seeds = (4, 9, 4)
    batch, counter = (EventCamera((3, H, W), RICH, seeds) for _ in range(2))
    alone = [EventCamera((H, W), RICH, seed) for seed in seeds]
    streams = [walk(n) for n in (0, 1, 0)]
    for step in range(30):
        if step == 12:  # the second begins again, between frames of the others
            for each in (batch, counter):
                each.reset([7], cameras=[1])
            alone[1].reset(7)
        frames, times = zip(*(stream[step] for stream in streams), strict=True)
        together = batch.process(np.array(frames), times[0])
        counts = np.zeros((3, 2, H, W), np.uint8)
        counter.count(np.array(frames), times, counts)
        for n, events in enumerate(together):
            assert events.tolist() == alone[n].process(*streams[n][step]).tolist()
            expected = np.zeros((2, H, W))
            np.add.at(expected, (1 - events["p"].astype(int), events["y"], events["x"]), 1)
            assert (counts[n] == expected).all()
    assert together[0].tolist() == together[2].tolist()  # of the same seed and frames


def test_a_rise_of_the_logarithm_makes_on_events_spread_over_the_frame():
    ideal = CameraParameters(mismatch=0.0)
    camera = EventCamera((1, 2), ideal)
    assert len(camera.process([[50.0, 50.0]], 0.0)) == 0
    events = camera.process([[50.0 * math.exp(0.65), 50.0 * math.exp(-0.25)]], 0.01)
    assert [(x, t, p) for x, _, t, p in events.tolist() if x == 0] == [
        (0, 3333, 1), (0, 6667, 1), (0, 10000, 1),
    ]  # fmt: skip
    assert [(t, p) for x, _, t, p in events.tolist() if x == 1] == [(3333, 0)]
    assert len(camera.process([[50.0 * math.exp(0.65), 50.0 * math.exp(-0.25)]], 0.02)) == 0


@pytest.mark.parametrize(
    ("parameters", "light", "expected"),
    [
        ({"leak_hz": 2.0, "mismatch": 0.0}, 100.0, 2.0),
        ({"shot_noise_hz": 5.0, "mismatch": 0.0}, 0.0, 5.0 * (1 - 0.75 * 20 / 275)),
        ({"shot_noise_hz": 5.0, "mismatch": 0.0}, 255.0, 5.0 * 0.25),
    ],
)
def test_a_still_scene_sends_leak_and_noise_at_their_rates(parameters, light, expected):
    camera = EventCamera((40, 40), parameters, 3)
    sent = [camera.process(np.full((40, 40), light), 0.005 * n) for n in range(403)]
    events = np.concatenate(sent)
    rate = len(events) / 1600 / 2.01
    assert rate == pytest.approx(expected, abs=4 * math.sqrt(expected / 3200))
    assert ("leak_hz" not in parameters) or events["p"].all()


def test_the_photoreceptor_is_slower_in_the_dark():
    steps = {}
    for light in (10.0, 200.0):
        camera = EventCamera((1, 1), {"mismatch": 0.0, "cutoff_hz": 10.0, "on_threshold": 0.05})
        camera.process([[light]], 0.0)
        steps[light] = sum(len(camera.process([[light * 1.2]], 0.001 * n)) for n in range(1, 11))
    assert 0 <= steps[10.0] < steps[200.0] <= math.log(1.2) / 0.05


def test_logarithms_given_are_those_of_luminances():
    frames = walk(5)
    given, logs = (EventCamera((H, W), "clean", 1, is_log=log) for log in (False, True))
    for frame, t in frames:
        bright = np.maximum(frame, 25.0)  # above the linear part
        assert given.process(bright, t).tolist() == logs.process(lin_log(bright), t).tolist()


def test_the_logarithm_of_bytes_is_that_of_numbers():
    assert (lin_log(np.arange(256, dtype=np.uint8)) == lin_log(np.arange(256.0))).all()
    assert lin_log(20.0) == pytest.approx(math.log(20.0))
    assert lin_log(10.0) == pytest.approx(math.log(20.0) / 2)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: EventCamera((0, 4)), "a shape of"),
        (lambda: EventCamera((4, 4), "sharp"), "no preset 'sharp'; there are clean, noisy, v2e"),
        (lambda: EventCamera((4, 4), {"gain": 1}), "no parameter 'gain'"),
        (lambda: EventCamera((4, 4), {"on_threshold": 0.0}), "on_threshold is 0.0"),
        (lambda: EventCamera((4, 4), {"cutoff_hz": math.nan}), "cutoff_hz is nan"),
        (lambda: EventCamera((3, 4, 4), "clean", 1), "1 seeds for 3 cameras"),
        (lambda: EventCamera((4, 4)).process(np.zeros((4, 5)), 0.0), "a frame of shape"),
        (lambda: EventCamera((1, 1)).process([[math.nan]], 0.0), "infinite or none"),
        (lambda: EventCamera((1, 1)).process([[1.0]], math.nan), "frames at .nan. s"),
    ],
)
def test_what_is_no_camera_or_frame_is_refused_in_a_line(call, message):
    with pytest.raises(EnvError, match=message) as caught:
        call()
    assert "\n" not in str(caught.value)


def test_a_frame_that_is_not_later_is_refused():
    camera = EventCamera((1, 1))
    camera.process([[1.0]], 0.5)
    with pytest.raises(EnvError, match="later"):
        camera.process([[1.0]], 0.5)
