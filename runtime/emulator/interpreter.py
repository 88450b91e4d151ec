"""The interpreter: the arithmetic of the chips as its specification, in chip time.

Short and slow on purpose. Integers are int64 (floats on `ideal` and `spinnaker2`). Everything fast
is tested to be equal to this in every current, membrane and spike.
"""

from collections.abc import Collection
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.chips.registers import Register, decay, shift_decay
from spikedeploy.runtime.compiler.program import Layer, Program
from spikedeploy.runtime.families.cuba.fixed_point import CubaFixedPoint
from spikedeploy.runtime.families.integrate_and_fire.arithmetic import IntegrateAndFire
from spikedeploy.runtime.families.integrate_and_fire.update import stepped
from spikedeploy.runtime.families.xylo.arithmetic import XyloArithmetic

Numbers = NDArray[Any]
Bits = NDArray[np.bool_]


@dataclass(eq=False)
class LayerState:
    """What a layer remembers between timesteps.

    current: (B, N) [state units]; (B, K, N) where neurons have K currents.
    membrane: (B, N) [state units].
    silent: (B, N) timesteps of refractory left.
    """

    current: Numbers
    membrane: Numbers
    silent: NDArray[np.int64]

    @classmethod
    def zero(cls, layer: Layer, batch: int) -> "LayerState":
        """The state of a layer that was just reset."""
        shape = (batch, layer.size)
        dtype = layer.threshold.dtype if layer.threshold.dtype.kind == "f" else np.dtype(np.int64)
        currents = np.zeros((batch, *layer.current_decay.shape), dtype)
        return cls(currents, np.zeros(shape, dtype), np.zeros(shape, np.int64))


@dataclass(frozen=True, eq=False)
class StepResult:
    """What a layer did in one timestep.

    spikes: (B, N); counts where neurons spike several times in a timestep.
    busy: (B, N) where there was a membrane, a current or a bias to add up.
    overflows: (B, N) how many of accumulator, current, push and membrane did not fit.
    """

    spikes: NDArray[Any]
    busy: Bits
    overflows: NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class LayerTrace:
    """Everything that a layer did in its window, after each timestep, resets included.

    current: (B, T, N) [state units]; (B, T, K, N) where neurons have K currents.
    membrane: (B, T, N) [state units].
    spikes: (B, T, N); counts where neurons spike several times in a timestep.
    busy: (B, T, N) as in Tick.
    overflows: (B, T, N) as in Tick.
    """

    current: Numbers
    membrane: Numbers
    spikes: NDArray[np.uint8]
    busy: Bits
    overflows: NDArray[np.int64]


def trace(program: Program, raster: NDArray[np.uint8]) -> dict[str, LayerTrace]:
    """What every layer does with the raster (B, T, M), from zero states."""
    return Interpreter(program, raster.shape[0]).run(raster)


class Interpreter:
    """A program running, one chip timestep after another."""

    def __init__(self, program: Program, batch: int) -> None:
        self.program = program
        self.states = {layer.name: LayerState.zero(layer, batch) for layer in program.layers}
        # last rows of the inference before: synapses with a lag still have to deliver them
        self._memory = max(lag for lags in program.lags for lag in lags)
        self.tails = {
            name: np.zeros((batch, self._memory, size), np.uint8)
            for name, size in program.sizes.items()
        }

    def run(
        self, raster: NDArray[np.uint8], waiting: Collection[str] = ()
    ) -> dict[str, LayerTrace]:
        """One inference; states go on from the one before.

        waiting: names of layers that stand still meanwhile.
        """
        program, timesteps = self.program, raster.shape[1]
        output_spikes = {name: _lengthened(tail, timesteps) for name, tail in self.tails.items()}
        output_spikes[program.input][:, self._memory :] = raster
        history: dict[str, list[tuple[Numbers, Numbers, StepResult]]] = {
            layer.name: [] for layer in program.layers
        }
        for step in range(program.steps(timesteps)):
            for layer in program.layers:
                if not layer.start <= step < layer.start + timesteps:
                    continue
                state = self.states[layer.name]
                if layer.name in waiting:
                    tick = _still(state)
                else:
                    tick = self._tick(layer, self._heard(layer, step, output_spikes), state)
                output_spikes[layer.name][:, self._memory + step - layer.start] = tick.spikes
                history[layer.name].append((state.current, state.membrane, tick))
        self.tails = {name: rows[:, timesteps:] for name, rows in output_spikes.items()}
        return {name: _stacked(ticks) for name, ticks in history.items()}

    def _tick(self, layer: Layer, presynaptic: list[Numbers], state: LayerState) -> StepResult:
        """Advance a layer by one timestep, in the arithmetic of the chip."""
        if self.program.chip.events is not None:
            return update_by_events(
                self.program, self.program.chip.events, layer, presynaptic, state
            )
        if self.program.chip.steps is not None:
            return update_by_steps(self.program, self.program.chip.steps, layer, presynaptic, state)
        return update(self.program, layer, _weights(layer, presynaptic), state)

    def _heard(
        self, layer: Layer, step: int, output_spikes: dict[str, NDArray[np.uint8]]
    ) -> list[Numbers]:
        """Spikes (B, M) that arrive through each synapse of a layer in a chip timestep."""
        presynaptic = []
        for synapses in layer.synapses:
            of = synapses.source
            start = 0 if of == self.program.input else self.program.layer(of).start
            presynaptic.append(output_spikes[of][:, self._memory + step - synapses.delay - start])
        return presynaptic


def _still(state: LayerState) -> StepResult:
    """What a layer does that has not started yet."""
    none = np.zeros(state.membrane.shape, np.int64)
    return StepResult(none, none.astype(np.bool_), none)


def _weights(layer: Layer, presynaptic: list[Numbers]) -> Numbers:
    """Sum of the weights (B, N) that arrive, those of the bias included."""
    total = layer.bias.astype(layer.threshold.dtype)
    for synapses, spikes in zip(layer.synapses, presynaptic, strict=True):
        arrived = spikes.astype(total.dtype) @ synapses.weight.astype(total.dtype)
        total = total + (arrived >> synapses.shift if synapses.shift else arrived)
    return total


def update(program: Program, layer: Layer, weights: Numbers, state: LayerState) -> StepResult:
    """Advance a layer by one timestep; the sum of the weights (B, N) arrives in it."""
    before = state.membrane
    current, membrane, overflows = _integrate(program.chip.fixed, layer, weights, state)
    held = state.silent > 0
    spikes = (membrane > layer.threshold) & ~held
    after = membrane - layer.threshold if program.convention.reset == "subtract" else 0
    refractory = program.chip.fixed.refractory if program.chip.fixed else 1
    state.current = current
    state.membrane = np.where(held, 0, np.where(spikes, after, membrane))
    state.silent = np.where(spikes, refractory - 1, np.maximum(state.silent - 1, 0))
    busy = (before != 0) | (current != 0) | (layer.voltage_bias != 0)
    return StepResult(spikes, busy, overflows)


def _integrate(
    fixed: CubaFixedPoint | None, layer: Layer, weights: Numbers, state: LayerState
) -> tuple[Numbers, Numbers, NDArray[np.int64]]:
    """The new current and membrane before any spike, and how many numbers overflowed."""
    if fixed is None:
        # I = a I + W s      V = b V + I + bias
        current = layer.current_decay * state.current + weights
        membrane = layer.membrane_decay * state.membrane + current + layer.voltage_bias
        return current, membrane, np.zeros(membrane.shape, np.int64)
    # u = keep_u u + (W s << 6)      v = keep_v v + (u + bias)      each as its register holds it
    drive, lost = _fit(fixed.accumulator, weights << fixed.mantissa_shift)
    kept = decay(state.current, layer.current_decay, fixed.decay_bits)
    current, wrapped = _fit(fixed.current, kept + drive)
    push, turned = _fit(fixed.push, current + layer.voltage_bias)
    kept = decay(state.membrane, layer.membrane_decay, fixed.decay_bits)
    membrane, clipped = _fit(fixed.membrane, kept + push)
    return current, membrane, lost + wrapped + turned + clipped


def update_by_events(
    program: Program,
    point: XyloArithmetic,
    layer: Layer,
    presynaptic: list[Numbers],
    state: LayerState,
) -> StepResult:
    """Advance a layer of Xylo by one timestep, in which these spikes (B, M) arrive."""
    current, lost = _arrived(program, point, layer, presynaptic, state.current)
    # I = I - dec(I)      V = V + (sum I - dec(V) + bias)      each sum as its register holds it
    current = current - shift_decay(current, layer.current_decay)
    # the lowest membrane with a dash of 0 leaks what does not fit: it stays where it is (xylosim)
    leak = point.leak.fit(-shift_decay(state.membrane, layer.membrane_decay))
    change, low = _fit(point.state, current.sum(axis=1) + leak)
    change, turned = _fit(point.state, change + layer.voltage_bias)
    membrane, high = _fit(point.state, state.membrane + change)
    is_output = layer.name == program.output and program.output_apart
    most = point.output_spikes_max if is_output else point.spikes_max
    spikes, membrane = _spikes(layer, membrane, most)
    busy = (state.membrane != 0) | current.any(axis=1) | (layer.voltage_bias != 0)
    state.current, state.membrane = current, membrane
    return StepResult(spikes, busy, lost + low + turned + high)


def update_by_steps(
    program: Program,
    point: IntegrateAndFire,
    layer: Layer,
    presynaptic: list[Numbers],
    state: LayerState,
) -> StepResult:
    """Advance a layer without synaptic currents by one timestep."""
    after = stepped(point, program.convention, layer, presynaptic, state.membrane)
    busy = (state.membrane != 0) | after.arrived
    state.membrane = after.membrane
    return StepResult(after.spikes, busy, after.lost)


def _spikes(layer: Layer, membrane: Numbers, most: int) -> tuple[Numbers, Numbers]:
    """Spikes (B, N) of the membranes, and what they leave of them; at most so many of a neuron."""
    budget = np.full(membrane.shape, most)
    if not layer.aliases:
        return _fired(membrane, layer.threshold, budget)
    membrane, spikes = membrane.copy(), 0 * budget
    for n, others in enumerate(layer.aliases):
        # spikes that were counted for a neuron before its turn use up its budget
        left = budget[:, n] - spikes[:, n]
        own, membrane[:, n] = _fired(membrane[:, n], layer.threshold[n], left)
        spikes[:, n] += own
        for other in others:
            spikes[:, other] = np.minimum(spikes[:, other] + spikes[:, n], most)
    return spikes, membrane


def _fired(membrane: Numbers, threshold: Numbers, budget: Numbers) -> tuple[Numbers, Numbers]:
    """Spikes while there is a threshold to take off the membrane, and what is left of it."""
    spikes = 0 * budget
    for _ in range(budget.max()):
        fires = (membrane >= threshold) & (spikes < budget)
        spikes, membrane = spikes + fires, membrane - threshold * fires
    return spikes, membrane


def _arrived(
    program: Program,
    point: XyloArithmetic,
    layer: Layer,
    presynaptic: list[Numbers],
    current: Numbers,
) -> tuple[Numbers, NDArray[np.int64]]:
    """The currents (B, K, N) after the events, axon by axon, and how many additions saturated."""
    current, lost = current.copy(), np.zeros((len(current), layer.size), np.int64)
    for synapses, counts in zip(layer.synapses, presynaptic, strict=True):
        weight, fed = synapses.weight.astype(np.int64), synapses.current
        events = counts.astype(np.int64)
        if synapses.source == program.input:
            events = events.clip(max=point.events_max)
        if (np.abs(current[:, fed]) + events @ np.abs(weight)).max() <= point.state.limit:
            # none of the sums can saturate on the way, and so their order does not matter
            current[:, fed] += events @ weight
            continue
        for copy, axon in np.argwhere(events):
            for _ in range(events[copy, axon]):
                raised = current[copy, fed] + weight[axon]
                current[copy, fed], over = _fit(point.state, raised)
                lost[copy] += over
    return current, lost


def _fit(register: Register, x: Numbers) -> tuple[Numbers, NDArray[np.int64]]:
    fitted = register.fit(x)
    return fitted, (fitted != x).astype(np.int64)


def _lengthened(tail: NDArray[np.uint8], timesteps: int) -> NDArray[np.uint8]:
    batch, _, size = tail.shape
    return np.concatenate([tail, np.zeros((batch, timesteps, size), np.uint8)], axis=1)


def _stacked(ticks: list[tuple[Numbers, Numbers, StepResult]]) -> LayerTrace:
    return LayerTrace(
        current=np.stack([current for current, _, _ in ticks], axis=1),
        membrane=np.stack([membrane for _, membrane, _ in ticks], axis=1),
        spikes=np.stack([tick.spikes for _, _, tick in ticks], axis=1).astype(np.uint8),
        busy=np.stack([tick.busy for _, _, tick in ticks], axis=1),
        overflows=np.stack([tick.overflows for _, _, tick in ticks], axis=1),
    )
