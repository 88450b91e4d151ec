"""The part of a camera that a network sees: events to neurons of its Input, time to timesteps.

Channel 0 of an Input (2, H, W) takes the events of polarity 0, where the light fell, and channel 1
those of polarity 1, as Tonic's frames do, unless it is asked for the other order, which the event
camera of envs/ observes; an Input (1, H, W) or (H, W) takes both as one.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from spikedeploy.emulation.event_files import EventRecording, Size
from spikedeploy.runtime.artifact.artifact import Artifact
from spikedeploy.runtime.camera_events import Events
from spikedeploy.runtime.errors import ConfigError, ObservationError
from spikedeploy.runtime.graph.ports import ports

# timesteps of a recording: a day in milliseconds; a wrong unit of t has more
_LONGEST = 100_000_000

Region = tuple[int, int, int, int]


@dataclass(frozen=True)
class EventView:
    """The neurons of an Input that events reach.

    shape: (C, H, W) of the Input.
    x, y: column and row of the camera where the view begins [pixels].
    downsample: pixels along each axis that become one; those left over at the right and at the
        bottom are not seen.
    on_first: whether channel 0 takes polarity 1, where the light rose.
    """

    shape: tuple[int, int, int]
    x: int = 0
    y: int = 0
    downsample: int = 1
    on_first: bool = False

    def neurons(self, events: Events) -> NDArray[np.int64]:
        """(E,) the neuron that each event reaches, (c H + y) W + x; -1 for those not seen."""
        channels, height, width = self.shape
        x = (events["x"].astype(np.int64) - self.x) // self.downsample
        y = (events["y"].astype(np.int64) - self.y) // self.downsample
        channel = (events["p"] ^ self.on_first) if channels == 2 else 0
        is_seen = (x >= 0) & (x < width) & (y >= 0) & (y < height)
        return np.where(is_seen, (channel * height + y) * width + x, -1)


def view_of(
    artifact: Artifact,
    camera: Size | None,
    region: Region | None,
    downsample: int = 1,
    on_first: bool = False,
) -> EventView:
    """The view of a network's Input; ConfigError where it is not of that size.

    camera: (height, width) [pixels], where it is known.
    region: x, y, width, height [pixels] of the part of the camera that is seen; None is all of it.
    downsample, on_first: as in EventView.
    """
    shape = input_shape(artifact)
    _, height, width = shape
    if downsample < 1:
        raise ConfigError(f"--downsample {downsample}: the least is 1 pixel.")
    if region is None:
        seen = camera or (height * downsample, width * downsample)
        x = y = 0
    else:
        x, y, *sides = region
        seen = sides[1], sides[0]
        inside = camera is None or (x + sides[0] <= camera[1] and y + sides[1] <= camera[0])
        if min(x, y) < 0 or min(sides) < 1 or not inside:
            size = f" of a camera of {camera[0]}x{camera[1]} pixels" if camera else ""
            raise ConfigError(
                f"--region {','.join(map(str, region))} (x,y,width,height) is not a part{size}. "
                "Give one inside, of at least one pixel."
            )
    if (seen[0] // downsample, seen[1] // downsample) != (height, width):
        raise ConfigError(
            f"the events come from {seen[0]}x{seen[1]} pixels (height x width), down-sampled by "
            f"{downsample}; the network takes {height}x{width}. {_remedy(seen, (height, width))}"
        )
    return EventView(shape, x, y, downsample, on_first)


def _remedy(seen: Size, wanted: Size) -> str:
    """The options by which a network sees as much as it can of what is there, from its middle."""
    times = min(seen[0] // wanted[0], seen[1] // wanted[1])
    if times < 1:
        return "Take a network of a smaller input, or a recording of a larger camera."
    sides = times * wanted[0], times * wanted[1]
    y, x = ((all_ - part) // 2 for all_, part in zip(seen, sides, strict=True))
    return f"Such as --downsample {times} --region {x},{y},{sides[1]},{sides[0]}"


def input_shape(artifact: Artifact) -> tuple[int, int, int]:
    """(C, H, W) of the only Input; ConfigError where events of a camera cannot be its input."""
    found = ports(artifact.graph.inputs)
    shape = found[0].shape
    if len(shape) == 2:
        shape = (1, *shape)
    if len(found) != 1 or len(shape) != 3 or shape[0] not in (1, 2):
        shown = ", ".join(f"{port.name!r} {port.shape}" for port in found)
        raise ConfigError(
            f"the network has the inputs {shown}; events of a camera need one Input (C, H, W) with "
            "C 1 or 2. Export the network with the shape of its pictures."
        )
    return shape[0], shape[1], shape[2]


@dataclass(frozen=True)
class EventInput:
    """A recording as the input of a network; all of its events are checked.

    recording, view: where the events come from, and the part that is seen.
    events: number of the recording's events.
    channels: number of those that each channel of the Input sees.
    first, last: times [us] of the first and the last event.
    step_us: duration of a timestep [us]; None where a chip takes one event after another. Timesteps
        are aligned to the camera's clock: k has the times from k step_us on.
    """

    recording: EventRecording
    view: EventView
    events: int
    channels: tuple[int, ...]
    first: int
    last: int
    step_us: float | None

    @property
    def seen(self) -> int:
        """Events that the network sees."""
        return sum(self.channels)

    @property
    def timesteps(self) -> int:
        """Timesteps from that of the first event on; 0 where there are none."""
        if self.step_us is None:
            return 0
        first, last = self._timestep(np.array([self.first, self.last])).tolist()
        return int(last - first) + 1

    def _timestep(self, times: NDArray[np.int64]) -> NDArray[np.int64]:
        """The timesteps in which times [us] are."""
        return np.floor(times / (self.step_us or 1.0)).astype(np.int64)

    @property
    def duration(self) -> float:
        """Time that the network runs [us]."""
        return self.timesteps * self.step_us if self.step_us else max(self.last - self.first, 1)

    @property
    def remarks(self) -> list[str]:
        """Remarks on the file, and on channels that no event reaches."""
        found = list(self.recording.remarks)
        if not self.seen:
            return [*found, "no event of the recording reaches the Input"]
        empty = [k for k, count in enumerate(self.channels) if not count]
        return found + [
            f"channel {k} of the Input got no event: all {self.seen:,} that reach it have the "
            "other polarity"
            for k in empty
        ]

    def rows(self) -> Iterator[NDArray[np.int64]]:
        """Counts (M,) of events of each neuron of the Input, timestep by timestep."""
        size, now = int(np.prod(self.view.shape)), 0
        start = int(self._timestep(np.array([self.first]))[0])
        row = np.zeros(size, np.int64)
        for events in self.recording.events():
            neuron = self.view.neurons(events)
            step = self._timestep(events["t"][neuron >= 0]) - start
            neuron = neuron[neuron >= 0]
            bounds = [*np.flatnonzero(np.diff(step, prepend=-1)).tolist(), len(step)]
            for first, end in pairwise(bounds):
                while now < step[first]:
                    yield row
                    row, now = np.zeros(size, np.int64), now + 1
                np.add.at(row, neuron[first:end], 1)
        while now < self.timesteps:
            yield row
            row, now = np.zeros(size, np.int64), now + 1


def read_input(recording: EventRecording, view: EventView, seconds: float | None) -> EventInput:
    """Read a recording once; ObservationError where it holds no event or an impossible one.

    seconds: duration of a timestep; None where there are none.
    """
    count = last = 0
    first: int | None = None
    channels, height, width = view.shape
    seen = np.zeros(channels, np.int64)
    for events in recording.events():
        first = int(events["t"][0]) if first is None else first
        last, count = int(events["t"][-1]), count + len(events)
        neurons = view.neurons(events)
        seen += np.bincount(neurons[neurons >= 0] // (height * width), minlength=channels)
    if first is None:
        raise ObservationError(f"{recording.path} holds no event. Record anew.")
    us = None if seconds is None else seconds * 1e6
    if us is not None and abs(us - round(us)) < 1e-6:
        us = float(round(us))
    found = EventInput(recording, view, count, tuple(seen.tolist()), first, last, us)
    if found.timesteps > _LONGEST:
        raise ConfigError(
            f"the recording lasts {(last - first) / 1e6:g} s, which are {found.timesteps} "
            f"timesteps of {seconds:g} s; at most {_LONGEST}. Give a longer --time-step, or "
            "correct the unit of t, which is microseconds."
        )
    return found
