"""Timesteps of the emulator as the core has them: tokens, words, states and clocks; bench files."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikedeploy.exporters.verilog.image import FORGET, STEP, CoreImage, OutputWords
from spikedeploy.exporters.verilog.to_verilog import hex_text
from spikedeploy.runtime.chips.layer import Recording
from spikedeploy.runtime.codec.codec import Codec
from spikedeploy.runtime.emulator.backend import BackendName
from spikedeploy.runtime.emulator.machine import Machine

Integers = NDArray[np.int64]

BENCH = "bench.v"
_SPARE = 4  # times as many clocks as without any waiting
_BITS64 = (1 << 64) - 1
# clocks of a token and its row beside the synapses, and of a spike's row
_TOKEN, _ROW = 2, 2
_UPDATE = 6  # READ twice, ADD, PUSH, ADD, STORE


@dataclass(frozen=True, eq=False)
class RecordedSteps:
    """Timesteps of the emulator, S of them.

    tokens: of each timestep; FORGET before a new episode, and STEP at the end.
    words: of each timestep, as they leave the core.
    current, membrane, spikes: (S, N) of all neurons.
    clocks: (S,) that the core takes where nothing waits, without those of a reset.
    """

    tokens: Sequence[Sequence[int]]
    words: Sequence[Sequence[int]]
    current: Integers
    membrane: Integers
    spikes: Integers
    clocks: Integers


def record(
    image: CoreImage,
    raster: NDArray[np.uint8],
    backend: BackendName = "interpreter",
    episodes: Collection[int] = (),
) -> RecordedSteps:
    """Timesteps of the emulator with input spikes (S, T, M) of one inference after another.

    episodes: inferences with which a new episode begins; each one does where states are reset.
    """
    program = image.program
    machine = Machine(program, 1, "none", trace=True, backend=backend)
    begins = range(len(raster)) if program.convention.state == "reset" else episodes
    words: list[list[int]] = []
    found: dict[str, list[Integers]] = {n: [] for n in ("current", "membrane", "spikes")}
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
    states = {name: np.concatenate(rows) for name, rows in found.items()}
    tokens = [
        [FORGET] * (s in begins and t == 0) + [*np.flatnonzero(row).tolist(), STEP]
        for s, inference in enumerate(raster)
        for t, row in enumerate(inference)
    ]
    clocks = _clocks(image, raster.reshape(-1, image.axons), states["spikes"])
    return RecordedSteps(tokens, words, **states, clocks=clocks)


def clocks_of(image: CoreImage, raster: NDArray[np.uint8]) -> Integers:
    """Clocks (S, T) of timesteps with input spikes (S, T, M)."""
    return record(image, raster, "numpy").clocks.reshape(raster.shape[:2])


def _clocks(image: CoreImage, raster: NDArray[np.uint8], spikes: Integers) -> Integers:
    """Clocks (S,) of timesteps with input spikes (S, M) and spikes of the neurons (S, N).

    A clock for each synapse of a row that is delivered, and those of policy_core.v's other states.
    """
    lengths = image.rows.lengths
    resets = image.program.convention.reset == "subtract"
    delivered = _ROW + lengths[image.axons :] + resets
    tokens = _TOKEN + _ROW + lengths[: image.axons]
    found: Integers = 1 + _idle_clocks(image) + (raster != 0) @ tokens + spikes @ delivered
    return found


def _idle_clocks(image: CoreImage) -> int:
    """Clocks in which all neurons are updated and all words leave, where none spikes."""
    total = 0
    for layer in image.program.layers:
        decays = np.stack([layer.current_decay.reshape(-1), layer.membrane_decay])
        whole = (decays == 0) | (decays == 1 << image.decay_bits)
        total += int(np.where(whole, 1, image.decay_bits).sum())
        total += (_UPDATE + layer.spiking) * layer.size
    # a word of spikes takes a clock for each of its 32 bits that is no neuron's
    return total + sum(
        output.words + (0 if output.silent else 32 * output.words - output.neurons)
        for output in image.outputs
    )


def words_of(recorded: Recording, output: OutputWords) -> NDArray[np.uint32]:
    """Words (T, words) that leave of a layer."""
    if output.silent:
        membranes: NDArray[np.uint32] = recorded.membrane[0].astype("<i4").view("<u4")
        return membranes
    spikes = recorded.spikes[0].astype(np.uint8)
    padded = np.zeros((len(spikes), 32 * output.words), np.uint8)
    padded[:, : output.neurons] = spikes
    return np.packbits(padded, axis=1, bitorder="little").view("<u4")


def episode_record(
    image: CoreImage, codec: Codec, observation: NDArray[np.float64], seed: int
) -> dict[str, Any]:
    """Observations (S, obs) of an episode, and the emulator's actions, as episode.json has them."""
    machine = Machine(image.program, 1, "none", backend="interpreter")
    raster = codec.encode_episode(observation, seed)
    action = np.concatenate([codec.decode(machine.infer(rows[None])) for rows in raster])
    return {"seed": seed, "observation": observation.tolist(), "action": action.tolist()}


def bench_files(image: CoreImage, recorded: RecordedSteps) -> dict[str, str]:
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
    clear = 2 * image.neurons * image.slots  # clocks of a reset
    resets = tokens.count(FORGET)
    clocks = int(recorded.clocks.sum()) + clear + resets * (1 + clear)
    counts = {"TOKENS": len(tokens), "WORDS": len(words), "UPDATES": len(updates)}
    counts["MOST_CLOCKS"] = _SPARE * clocks
    return {
        "vectors.vh": "".join(f"localparam {name} = {n};\n" for name, n in counts.items()),
        "tokens.hex": hex_text(tokens, 16),
        "words.hex": hex_text(words, 33),
        "updates.hex": hex_text(updates, 129),
    }
