"""Words that leave a core, and the actions of an episode, as the emulator has them."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikedeploy.exporters.verilog.image import CoreImage, Output
from spikedeploy.runtime.codec.codec import Codec
from spikedeploy.runtime.emulator.backend import Recording
from spikedeploy.runtime.emulator.machine import Machine


def words_of(recorded: Recording, output: Output) -> NDArray[np.uint32]:
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
