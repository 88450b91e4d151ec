"""The replay of a run over a recording, for pages: pictures of all layers, and curves.

The recording is divided into at most 1,000 spans, of 10 ms where it is short. Curves count
everything in each. A picture holds the neurons that spiked in a span, or in its beginning where
spans are longer than a frame of film. Large networks have a picture in every few spans.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikedeploy.emulation.event_input import EventInput
from spikedeploy.emulation.event_stream import EventRun, node_shape
from spikedeploy.recordings import curve, pack, pack_bits
from spikedeploy.runtime.artifact.artifact import Artifact

_SPANS = 1000
_SHORTEST = 10_000.0  # [us] of a span: shorter pictures pass too fast to be seen
_FRAME = 40_000.0  # [us] that a picture sums at most
_MOST_CELLS = 1 << 25  # neurons of all pictures: 4 MB before they are packed
_MOST_OUTPUTS = 1000  # values of an output, above which it has no curve


class Replay:
    """Pictures and curves of a run, in bounded memory; a Listener.

    A span has some whole timesteps, where there are timesteps.
    """

    def __init__(self, artifact: Artifact, given: EventInput) -> None:
        duration, step = given.duration, given.step_us or 1.0
        span = max(duration / _SPANS, min(_SHORTEST, duration / 100))
        self._artifact = artifact
        self.span = step * max(1, int(np.ceil(span / step)))
        self.frame = min(self.span, max(step, _FRAME))
        self.spans = max(1, int(np.ceil(duration / self.span)))
        sizes = [node_shape(artifact, name) for name in (*artifact.graph.inputs, *artifact.neurons)]
        cells = self.spans * sum(int(np.prod(size)) for size in sizes)
        self.every = -(-cells // _MOST_CELLS)  # spans from picture to picture
        self._pictures: dict[str, NDArray[np.bool_]] = {}
        self._counts: dict[str, NDArray[np.int64]] = {}
        self._outputs: NDArray[np.float64] | None = None
        self._outputs_seen = np.zeros(self.spans, np.int64)

    def add_spikes(
        self, name: str, at: NDArray[Any], neurons: NDArray[Any], counts: NDArray[Any]
    ) -> None:
        """Count spikes, and put their neurons into the picture of their span."""
        if name not in self._pictures:
            size = int(np.prod(map_shape(self._artifact, name)))
            self._pictures[name] = np.zeros((-(-self.spans // self.every), size), np.bool_)
            self._counts[name] = np.zeros(self.spans, np.int64)
        spans = np.minimum((at / self.span).astype(np.int64), self.spans - 1)
        np.add.at(self._counts[name], spans, np.abs(counts).astype(np.int64))
        is_shown = (spans % self.every == 0) & (at < spans * self.span + self.frame)
        self._pictures[name][spans[is_shown] // self.every, neurons[is_shown]] = True

    def add_output(self, at: float, values: NDArray[np.float64]) -> None:
        """Add an output to those of its span."""
        if values.size > _MOST_OUTPUTS:
            return
        if self._outputs is None:
            self._outputs = np.zeros((self.spans, values.size))
        span = min(int(at / self.span), self.spans - 1)
        self._outputs[span] += values.ravel()
        self._outputs_seen[span] += 1

    def as_json(self, run: EventRun) -> dict[str, Any]:
        """The episode of a page, whose control steps are the spans."""
        seconds = self.span / 1e6
        maps = []
        for name, rows in self._pictures.items():
            shape = map_shape(run.artifact, name)
            size = "×".join(map(str, node_shape(run.artifact, name)))
            maps.append({"name": name, "size": size, "shape": shape, "spikes": pack_bits(rows)})
        tracks = [
            curve(f"{'events' if name in run.artifact.graph.inputs else 'spikes'} of {name}",
                  "per s", counts / seconds)
            for name, counts in self._counts.items()
        ]  # fmt: skip
        outputs = None
        if self._outputs is not None:
            outputs = pack(self._outputs / np.maximum(self._outputs_seen, 1)[:, None])
        player = {
            "label": f"{run.given.recording.path.name} on {run.chip}",
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
            "title": run.given.recording.path.name,
            "seed": None,
            "period": seconds,
            "scene": {
                "kind": "maps",
                "maps": maps,
                "every": self.every,
                "on_first": run.given.view.on_first,
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
