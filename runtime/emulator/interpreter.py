"""The interpreter: a program run timestep by timestep, by the specification of its arithmetic.

Short and slow on purpose. Integers are int64 (floats on `ideal` and on SpiNNaker2).
Everything fast is tested to be equal to this in every current, membrane and spike.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.chips.layer import Layer, LayerState, Numbers, StepResult
from spikedeploy.runtime.compiler.program import Program


@dataclass(frozen=True, eq=False)
class LayerTrace:
    """Everything that a layer did in its window, after each timestep, resets included.

    current: (B, T, N) [state units]; (B, T, K, N) where neurons have K currents.
    membrane: (B, T, N) [state units].
    spikes: (B, T, N); counts where neurons spike several times in a timestep, signed numbers in
        int64 of sigma-delta neurons.
    active: (B, T, N) as in StepResult.
    overflows: (B, T, N) as in StepResult.
    lost: (B, T, N) as in StepResult.
    """

    current: Numbers
    membrane: Numbers
    spikes: NDArray[np.integer[Any]]
    active: NDArray[np.bool_]
    overflows: NDArray[np.int64]
    lost: NDArray[np.int64] | None = None

    def part(self, window: slice) -> "LayerTrace":
        """The same of some of the timesteps."""
        lost = None if self.lost is None else self.lost[:, window]
        numbers = self.current[:, window], self.membrane[:, window], self.spikes[:, window]
        return LayerTrace(*numbers, self.active[:, window], self.overflows[:, window], lost)


def trace(program: Program, raster: NDArray[np.uint8]) -> dict[str, LayerTrace]:
    """What every layer does in its window with the raster (B, T, M), from zero states."""
    rows = program.rows(raster.shape[1])
    filled = np.pad(raster, ((0, 0), (0, rows - raster.shape[1]), (0, 0)))
    found = Interpreter(program, raster.shape[0]).run(filled)
    return {
        name: each.part(program.window(program.layer(name), rows)) for name, each in found.items()
    }


class Interpreter:
    """A program running, one chip timestep after another."""

    def __init__(self, program: Program, batch: int) -> None:
        self.program = program
        self.states = {layer.name: LayerState.zero(layer, batch) for layer in program.layers}
        # last rows of the inference before: synapses with a lag still have to deliver them
        self._memory = max(lag for lags in program.lags for lag in lags)
        graded = program.graded
        self.tails: dict[str, NDArray[np.integer[Any]]] = {
            name: np.zeros((batch, self._memory, size), np.int64 if name in graded else np.uint8)
            for name, size in program.sizes.items()
        }

    def run(
        self, raster: NDArray[np.uint8], waiting: Collection[str] = ()
    ) -> dict[str, LayerTrace]:
        """One inference; states go on from the one before.

        raster: (B, T, M), where layers run free with the rows behind the input's last.
        waiting: names of layers that are held meanwhile.
        """
        program, timesteps = self.program, raster.shape[1]
        begins = {layer.name: program.begin(layer) for layer in program.layers}
        biased = {layer.name: program.window(layer, timesteps) for layer in program.layers}
        output_spikes = {name: _lengthened(tail, timesteps) for name, tail in self.tails.items()}
        output_spikes[program.input][:, self._memory :] = raster
        history: dict[str, list[tuple[Numbers, Numbers, StepResult]]] = {
            layer.name: [] for layer in program.layers
        }
        for step in range(program.steps(timesteps)):
            together = self._together(step, output_spikes)
            for layer in program.layers:
                row = step - begins[layer.name]
                if not 0 <= row < timesteps:
                    continue
                state = self.states[layer.name]
                if layer.name in together:
                    tick = together[layer.name]
                elif layer.name in waiting:
                    tick = _waiting(state)
                else:
                    presynaptic = self._presynaptic(layer, step, output_spikes)
                    now = layer if row in range(timesteps)[biased[layer.name]] else unbiased(layer)
                    tick = self._advanced(now, step, presynaptic, state)
                output_spikes[layer.name][:, self._memory + row] = tick.spikes
                history[layer.name].append((state.current, state.membrane, tick))
        self.tails = {name: rows[:, timesteps:] for name, rows in output_spikes.items()}
        return {name: _stacked(ticks, output_spikes[name].dtype) for name, ticks in history.items()}

    def _together(
        self, step: int, output_spikes: dict[str, NDArray[np.integer[Any]]]
    ) -> Mapping[str, StepResult]:
        """A timestep of all layers, where the chip advances them as one; else nothing."""
        arithmetic = self.program.chip.arithmetic
        if not arithmetic.together:
            return {}
        presynaptic = {
            layer.name: self._presynaptic(layer, step, output_spikes)
            for layer in self.program.layers
        }
        return arithmetic.update_together(self.program, presynaptic, self.states)

    def _advanced(
        self, layer: Layer, step: int, presynaptic: Sequence[Numbers], state: LayerState
    ) -> StepResult:
        """A timestep of a layer, in which these spikes (B, M) of its synapses arrive."""
        return self.program.chip.arithmetic.update(self.program, layer, presynaptic, state)

    def _presynaptic(
        self, layer: Layer, step: int, output_spikes: dict[str, NDArray[np.integer[Any]]]
    ) -> list[Numbers]:
        """Spikes (B, M) that arrive through each synapse of a layer in a chip timestep."""
        presynaptic = []
        for synapses in layer.synapses:
            of = synapses.source
            begin = 0 if of == self.program.input else self.program.begin(self.program.layer(of))
            presynaptic.append(output_spikes[of][:, self._memory + step - synapses.delay - begin])
        return presynaptic


def unbiased(layer: Layer) -> Layer:
    """The layer while its bias axon is silent."""
    return replace(layer, bias=0 * layer.bias) if layer.bias.any() else layer


def _waiting(state: LayerState) -> StepResult:
    """What a layer does that has not started yet."""
    none = np.zeros(state.membrane.shape, np.int64)
    return StepResult(none, none.astype(np.bool_), none)


def _lengthened(tail: NDArray[np.integer[Any]], timesteps: int) -> NDArray[np.integer[Any]]:
    batch, _, size = tail.shape
    return np.concatenate([tail, np.zeros((batch, timesteps, size), tail.dtype)], axis=1)


def _stacked(
    ticks: list[tuple[Numbers, Numbers, StepResult]], kind: np.dtype[np.integer[Any]]
) -> LayerTrace:
    lost = [tick.lost for _, _, tick in ticks if tick.lost is not None]
    return LayerTrace(
        current=np.stack([current for current, _, _ in ticks], axis=1),
        membrane=np.stack([membrane for _, membrane, _ in ticks], axis=1),
        spikes=np.stack([tick.spikes for _, _, tick in ticks], axis=1).astype(kind),
        active=np.stack([tick.active for _, _, tick in ticks], axis=1),
        overflows=np.stack([tick.overflows for _, _, tick in ticks], axis=1),
        lost=np.stack(lost, axis=1) if lost else None,
    )
