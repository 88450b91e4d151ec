"""Small layers one after another, advanced together in one stack: a pipeline over the layers.

A layer of a few neurons costs its calls and not its numbers. So chunk k of the window of layer l is
computed at the same time as chunk k + 1 of the layer before it: one matrix product, and one set of
calls per timestep, for all layers at once. A quarter faster for karts (docs/performance.md).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import count, pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.chips.layer import Layer
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.emulator.backend import SavedState
from spikedeploy.runtime.families.cuba.bounds import bounds
from spikedeploy.runtime.families.cuba.fixed_point import CubaFixedPoint
from spikedeploy.runtime.families.cuba_numpy.layer_kernel import proven
from spikedeploy.runtime.families.cuba_numpy.neuron_update import NeuronUpdate
from spikedeploy.runtime.families.cuba_numpy.sums import EXACT_FLOAT32

Floats = NDArray[np.float64]
Bits = NDArray[np.bool_]

# timesteps that are computed between two matrix products: fewer make more products, more let the
# layers start later
CHUNK = 4

# weights of all layers in one matrix, zeros included, above which the product is not worth it
LARGEST = 50_000

# windows that are shorter are over before the last layer starts
SHORTEST = 4 * CHUNK


@dataclass(frozen=True, eq=False)
class _Strip:
    """The window of one layer, a view of the stack; as in LayerWindow.

    states: (T + 1, 2, 1, N).
    spikes: (T, 1, N).
    """

    layer: Layer
    states: Floats
    spikes: Bits
    ordinary: bool = True
    waiting: bool = False
    interpreted: bool = False
    overflows: int = 0

    def saved(self) -> SavedState:
        """Copies of the states."""
        return {"states": self.states[-1].copy()}

    def restore(self, saved: SavedState) -> None:
        """Show these states; the next window begins from zero."""
        self.states[-1] = saved["states"]


class Wave:
    """All layers of a program in one stack, for windows of T timesteps of one copy.

    windows: of the layers.
    """

    def __init__(self, program: Program, fixed: CubaFixedPoint, timesteps: int) -> None:
        layers, width = program.layers, program.width
        ends = [0, *np.cumsum([layer.size for layer in layers]).tolist()]
        self._places = [slice(*edges) for edges in pairwise(ends)]
        self._chunks = -(-timesteps // CHUNK) + len(layers) - 1
        rows, neurons = self._chunks * CHUNK, ends[-1]
        # a chunk of rows earlier than the others comes what the input did
        self._output_spikes = np.zeros((CHUNK + rows, width + neurons), np.bool_)
        self._input = self._output_spikes[:timesteps, :width]
        self._states = np.zeros((rows + 1, 2, 1, neurons))
        self._drive = np.empty((rows, 1, neurons))
        self._block, bias = _block(program, fixed, self._places)
        self._presynaptic = np.empty((CHUNK, len(self._block)), np.float32)
        self._arrived = np.empty((CHUNK, neurons), np.float32)
        self._bias = np.tile(bias, (CHUNK, 1)) if bias.any() else None
        stack = _stacked(layers)
        spikes = self._output_spikes[CHUNK:, None, width:]
        subtract = program.convention.reset == "subtract"
        self._update = NeuronUpdate(
            stack, fixed, self._states, self._drive, spikes, False, subtract
        )
        self.windows = [
            _Strip(
                layer,
                self._states[start : start + timesteps + 1, :, :, place],
                spikes[start : start + timesteps, :, place],
            )
            for layer, place, start in zip(layers, self._places, count(0, CHUNK), strict=False)
        ]

    def run(self, rows: NDArray[Any]) -> None:
        """Fill the windows, given the spikes of the input (T, 1, M)."""
        self._input[...] = rows[:, 0]
        axons = len(self._block)
        for chunk in range(self._chunks):
            here = slice(chunk * CHUNK, (chunk + 1) * CHUNK)
            np.copyto(self._presynaptic, self._output_spikes[here, :axons])
            self._presynaptic.dot(self._block, self._arrived)
            if self._bias is not None:
                np.add(self._arrived, self._bias, self._arrived)
            np.copyto(self._drive[here, 0], self._arrived)
            if 0 < chunk < len(self._places):
                # what a layer did before its window began is forgotten
                self._states[here.start, :, :, self._places[chunk]] = 0.0
            self._update.run(here)
        self._update.finish()


def suits(program: Program, fixed: CubaFixedPoint, timesteps: int, batch: int) -> bool:
    """Whether a wave computes the program, exactly and faster than its layers one by one."""
    layers = program.layers
    if batch > 1 or timesteps < SHORTEST or len(layers) < 2:
        return False
    neurons = sum(layer.size for layer in layers)
    if (program.width + neurons) * neurons > LARGEST:
        return False
    sources = [program.input, *(layer.name for layer in layers)]
    chained = all(
        [s.source for s in layer.synapses] == [before]
        for layer, before in zip(layers, sources, strict=False)
    )
    late = any(lag for lags in program.lags for lag in lags)
    last = layers[-1].name == program.output
    if not chained or late or not last or (program.readout and program.readout.lag):
        return False
    one = 1 << fixed.mantissa_shift
    return all(
        proven(program, layer, fixed, timesteps)
        and bounds(program, layer, fixed, timesteps).partial * one < EXACT_FLOAT32
        for layer in layers
    )


def _block(
    program: Program, fixed: CubaFixedPoint, places: list[slice]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Weights of every layer in one matrix, and all biases [state units]."""
    width, unit = program.width, np.float32(1 << fixed.mantissa_shift)
    block = np.zeros((width + places[-1].start, places[-1].stop), np.float32)
    first = 0
    for layer, place in zip(program.layers, places, strict=True):
        weight = layer.synapses[0].weight
        block[first : first + len(weight), place] = weight * unit
        first += len(weight)
    return block, np.concatenate([layer.bias for layer in program.layers]).astype(np.float32) * unit


def _stacked(layers: Sequence[Layer]) -> Layer:
    """The neurons of all layers as those of one, without synapses."""
    return replace(
        layers[0],
        synapses=(),
        threshold=np.concatenate([layer.threshold for layer in layers]),
        voltage_bias=np.concatenate([layer.voltage_bias for layer in layers]),
        current_decay=np.concatenate([layer.current_decay for layer in layers]),
        membrane_decay=np.concatenate([layer.membrane_decay for layer in layers]),
    )
