"""Contents of the self-checking bench: tokens of timesteps, and what the emulator makes of them."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spikedeploy.exporters.verilog.image import CoreImage
from spikedeploy.exporters.verilog.model import FORGET, CoreModel, clocks_of, tokens_of
from spikedeploy.exporters.verilog.text import hex_text
from spikedeploy.exporters.verilog.vectors import words_of
from spikedeploy.runtime.emulator.backend import BackendName
from spikedeploy.runtime.emulator.machine import Machine

BENCH = "bench.v"
_SPARE = 4  # times as many clocks as without any waiting
_BITS64 = (1 << 64) - 1


@dataclass(frozen=True, eq=False)
class Recorded:
    """Timesteps of the emulator, S of them.

    tokens: of each timestep; FORGET before a new episode, and STEP at the end.
    words: of each timestep, as they leave the core.
    current, membrane, spikes: (S, N) of all neurons.
    """

    tokens: Sequence[Sequence[int]]
    words: Sequence[Sequence[int]]
    current: NDArray[np.int64]
    membrane: NDArray[np.int64]
    spikes: NDArray[np.int64]


def record(
    image: CoreImage,
    raster: NDArray[np.uint8],
    backend: BackendName = "interpreter",
    episodes: Collection[int] = (),
) -> Recorded:
    """Timesteps of the emulator with input spikes (S, T, M) of one inference after another.

    episodes: inferences with which a new episode begins; each one does where states are reset.
    """
    program = image.program
    machine = Machine(program, 1, "none", trace=True, backend=backend)
    begins = range(len(raster)) if program.convention.state == "reset" else episodes
    words: list[list[int]] = []
    found: dict[str, list[NDArray[np.int64]]] = {n: [] for n in ("current", "membrane", "spikes")}
    for s, inference in enumerate(raster):
        if s in begins:
            machine.reset()
        machine.infer(inference[None])
        seen = machine.recordings
        each = [words_of(seen[output.layer], output) for output in image.outputs]
        words += np.concatenate(each, axis=1).tolist()
        for name, rows in found.items():
            layers = [getattr(seen[layer.name], name)[0] for layer in program.layers]
            rows.append(np.concatenate(layers, axis=1).astype(np.int64))
    together = {name: np.concatenate(rows) for name, rows in found.items()}
    return Recorded(tokens_of(raster, begins), words, **together)


def bench_files(image: CoreImage, recorded: Recorded) -> dict[str, str]:
    """Text of the files that bench.v reads, by name."""
    words = [
        (k == len(each) - 1) << 32 | word for each in recorded.words for k, word in enumerate(each)
    ]
    tokens = [token for each in recorded.tokens for token in each]
    states = (recorded.current, recorded.membrane, recorded.spikes)
    updates = [
        (current & _BITS64) << 65 | (membrane & _BITS64) << 1 | spike
        for current, membrane, spike in zip(*(s.ravel().tolist() for s in states), strict=True)
    ]
    counts = {"TOKENS": len(tokens), "WORDS": len(words), "UPDATES": len(updates)}
    counts["MOST_CLOCKS"] = _SPARE * _clocks(image, recorded)
    return {
        "vectors.vh": "".join(f"localparam {name} = {n};\n" for name, n in counts.items()),
        "tokens.hex": hex_text(tokens, 16),
        "words.hex": hex_text(words, 33),
        "updates.hex": hex_text(updates, 129),
    }


def _clocks(image: CoreImage, recorded: Recorded) -> int:
    """Clocks of all timesteps without any waiting."""
    clear = CoreModel(image).clear_clocks
    resets = sum(tokens[0] == FORGET for tokens in recorded.tokens)
    return sum(clocks_of(image, recorded.tokens)) + clear + resets * (1 + clear)
