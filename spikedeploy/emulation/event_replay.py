"""The replay of a run over a recording, for pages: pictures of all layers, and curves.

The recording is divided into at most 1,000 spans, of 10 ms where it is short. Curves count
everything in each. A picture holds the neurons that spiked in a span, or in its beginning where
spans are longer than a frame of film.
Where all pictures were too many bytes every second one is left out, until they are not.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikedeploy.emulation.event_input import Survey, TimeSteps
from spikedeploy.emulation.event_stream import EventRun, node_shape
from spikedeploy.recordings import curve, pack, pack_bits
from spikedeploy.runtime.artifact.artifact import Artifact

_SPANS = 1000
_SHORTEST = 10_000.0  # [us] of a span: shorter pictures pass too fast to be seen
_FRAME = 40_000.0  # [us] that a picture sums at most
_MOST_CELLS = 600_000  # neurons that spiked, in all pictures: about 2 MB of the page
_MOST_OUTPUTS = 1000  # values of an output, above which it has no curve


class Replay:
    """Pictures and curves of a run, in bounded memory; a Listener.

    found: the survey of the recording.
    steps: timesteps, of which a span has some whole ones; None where there are none.
    """

    def __init__(self, found: Survey, steps: TimeSteps | None) -> None:
        duration, step = found.duration(steps), steps.us_each if steps else 1.0
        span = max(duration / _SPANS, min(_SHORTEST, duration / 100))
        self.span = step * max(1, int(np.ceil(span / step)))
        self.frame = min(self.span, max(step, _FRAME))
        self.spans = max(1, int(np.ceil(duration / self.span)))
        self.every = 1  # spans from picture to picture
        self._pictures: dict[str, dict[int, NDArray[np.int64]]] = {}
        self._counts: dict[str, NDArray[np.int64]] = {}
        self._outputs: NDArray[np.float64] | None = None
        self._heard = np.zeros(self.spans, np.int64)
        self._cells = 0

    def add_spikes(
        self, name: str, at: NDArray[Any], neurons: NDArray[Any], counts: NDArray[Any]
    ) -> None:
        """Count spikes, and put their neurons into the picture of their span."""
        pictures = self._pictures.setdefault(name, {})
        total = self._counts.setdefault(name, np.zeros(self.spans, np.int64))
        spans = np.minimum((at / self.span).astype(np.int64), self.spans - 1)
        np.add.at(total, spans, np.abs(counts).astype(np.int64))
        is_shown = (spans % self.every == 0) & (at < spans * self.span + self.frame)
        for span in np.unique(spans[is_shown]).tolist():
            seen = np.unique(neurons[is_shown & (spans == span)])
            if (before := pictures.get(span)) is not None:
                seen = np.union1d(before, seen)
            self._cells += len(seen) - (0 if before is None else len(before))
            pictures[span] = np.asarray(seen, np.int64)
        while self._cells > _MOST_CELLS and self.every < self.spans:
            self._thin()

    def add_output(self, at: float, values: NDArray[np.float64]) -> None:
        """Add an output to those of its span."""
        if values.size > _MOST_OUTPUTS:
            return
        if self._outputs is None:
            self._outputs = np.zeros((self.spans, values.size))
        span = min(int(at / self.span), self.spans - 1)
        self._outputs[span] += values.ravel()
        self._heard[span] += 1

    def _thin(self) -> None:
        """Drop every second picture."""
        self.every *= 2
        for name, pictures in self._pictures.items():
            self._pictures[name] = {k: row for k, row in pictures.items() if not k % self.every}
        self._cells = sum(len(row) for each in self._pictures.values() for row in each.values())

    def as_json(self, run: EventRun) -> dict[str, Any]:
        """The episode of a page, whose control steps are the spans."""
        seconds = self.span / 1e6
        maps = []
        for name, pictures in self._pictures.items():
            shape = map_shape(run.artifact, name)
            rows = np.zeros((-(-self.spans // self.every), int(np.prod(shape))), np.bool_)
            for span, neurons in pictures.items():
                rows[span // self.every, neurons] = True
            size = "×".join(map(str, node_shape(run.artifact, name)))
            maps.append({"name": name, "size": size, "shape": shape, "spikes": pack_bits(rows)})
        tracks = [
            curve(f"{'events' if name in run.artifact.graph.inputs else 'spikes'} of {name}",
                  "per s", counts / seconds)
            for name, counts in self._counts.items()
        ]  # fmt: skip
        outputs = None
        if self._outputs is not None:
            outputs = pack(self._outputs / np.maximum(self._heard, 1)[:, None])
        player = {
            "label": f"{run.recording.path.name} on {run.chip}",
            "kind": "snn",
            "steps": self.spans,
            "total": None,
            "every": 1,
            "poses": None,
            "reward": None,
            "actions": outputs,
            "tracks": tracks,
            "network": None,
        }
        return {
            "title": run.recording.path.name,
            "seed": None,
            "period": seconds,
            "scene": {
                "kind": "maps",
                "maps": maps,
                "every": self.every,
                "on_first": run.view.on_first,
            },
            "players": [player],
            "distance": None,
            "twin": False,
            "first_spike": None,
        }

    def describe(self) -> str:
        """A sentence on what is shown."""
        shown = "" if self.frame == self.span else f" the first {_ms(self.frame)} of"
        rest = "" if self.every == 1 else f" every {self.every}th of"
        return (
            f"A picture holds the neurons that spiked in{shown} {_ms(self.span)}; shown are"
            f"{rest or ' all of'} {self.spans:,} pictures. Curves count everything."
        )


def _ms(us: float) -> str:
    return f"{us / 1e3:g} ms"


def map_shape(artifact: Artifact, name: str) -> list[int]:
    """(C, H, W) of a node as pictures; neurons without places are laid out as a square."""
    shape = node_shape(artifact, name)
    if len(shape) == 3:
        return list(shape)
    if len(shape) == 2:
        return [1, *shape]
    size = int(np.prod(shape))
    width = size if size <= 16 else int(np.ceil(np.sqrt(size)))
    return [1, -(-size // width), width]
