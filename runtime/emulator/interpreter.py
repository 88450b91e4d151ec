"""The interpreter: a program run timestep by timestep, by the specification of its arithmetic.

Short and slow on purpose. Integers are int64 (floats on `ideal` and on SpiNNaker2). Everything fast
is tested to be equal to this in every current, membrane and spike, and to `count` in every event.

As a backend it runs the chips without kernels, and every chip with upsets (runtime.chips.damage). A
layer's timestep begins with the flips and ends with the loss: a neuron whose spike is lost was
reset, one that did not send a spurious spike was not. The ledger counts what arrives.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.chips.damage import Damage, UpsetDraws
from spikedeploy.runtime.chips.layer import Layer, LayerState, Numbers, Recording, StepResult
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.emulator.backend import SavedState, Schedule, check_counts
from spikedeploy.runtime.emulator.ledger import Counts, LedgerBuilder, count_events

SpikeCounts = NDArray[np.integer[Any]]


@dataclass(frozen=True, eq=False)
class LayerTrace(Recording):
    """States and spikes of a layer after each timestep of its window, resets included.

    active: (B, T, N) as in StepResult.
    overflows: (B, T, N) as in StepResult.
    lost: (B, T, N) as in StepResult.
    """

    active: NDArray[np.bool_ | np.int64]
    overflows: NDArray[np.int64]
    lost: NDArray[np.int64] | None = None


def trace(program: Program, raster: NDArray[np.uint8]) -> dict[str, LayerTrace]:
    """Return the trace of every layer in its window for the raster (B, T, M), from zero states."""
    rows = program.rows(raster.shape[1])
    filled = np.pad(raster, ((0, 0), (0, rows - raster.shape[1]), (0, 0)))
    found = Interpreter(program, raster.shape[0]).run(filled)
    return {
        name: each.part(program.window(program.layer(name), rows)) for name, each in found.items()
    }


class Interpreter:
    """A program running, one chip timestep after another.

    states: of each layer.
    tails: (B, lag, N) the last spikes of each layer and of the input: synapses with a lag still
        have to deliver them.
    """

    def __init__(self, program: Program, batch: int, draws: UpsetDraws | None = None) -> None:
        self.program = program
        self.states = {layer.name: LayerState.zero(layer, batch) for layer in program.layers}
        self._draws = draws
        self._memory = max(lag for lags in program.lags for lag in lags)
        self._unbiased = {layer.name: _without_bias(layer) for layer in program.layers}
        self.tails: dict[str, SpikeCounts] = {
            name: np.zeros((batch, self._memory, size), self._dtype(name))
            for name, size in program.sizes.items()
        }

    def run(
        self, raster: NDArray[np.uint8], waiting: Collection[str] = ()
    ) -> dict[str, LayerTrace]:
        """Run one inference; states continue from the previous one.

        raster: (B, T, M), where layers run free with the rows behind the input's last.
        waiting: names of layers that are held meanwhile.
        """
        program, timesteps = self.program, raster.shape[1]
        sent = {name: _lengthen(tail, timesteps) for name, tail in self.tails.items()}
        sent[program.input][:, self._memory :] = raster
        done: dict[str, list[tuple[Numbers, Numbers, StepResult]]] = {n: [] for n in self.states}
        for step in range(program.steps(timesteps)):
            together = self._update_together(step, sent)
            for layer in program.layers:
                row = step - program.begin(layer)
                if not 0 <= row < timesteps:
                    continue
                state = self.states[layer.name]
                if together:
                    result = together[layer.name]
                elif layer.name in waiting:
                    result = _wait(state)
                else:
                    presynaptic = self._presynaptic(layer, step, sent)
                    in_window = row in range(timesteps)[program.window(layer, timesteps)]
                    result = self._update(layer, in_window, step, presynaptic, state)
                sent[layer.name][:, self._memory + row] = result.spikes
                done[layer.name].append((state.current, state.membrane, result))
        self.tails = {name: rows[:, timesteps:] for name, rows in sent.items()}
        return {name: _stack(results, self._dtype(name)) for name, results in done.items()}

    def _update_together(
        self, step: int, sent: Mapping[str, SpikeCounts]
    ) -> Mapping[str, StepResult]:
        """A timestep of all layers, where the chip advances them as one; else nothing."""
        arithmetic, layers = self.program.chip.arithmetic, self.program.layers
        if not arithmetic.all_at_once:
            return {}
        presynaptic = {layer.name: self._presynaptic(layer, step, sent) for layer in layers}
        return arithmetic.update_together(self.program, presynaptic, self.states)

    def _update(
        self,
        layer: Layer,
        in_window: bool,
        step: int,
        presynaptic: Sequence[Numbers],
        state: LayerState,
    ) -> StepResult:
        """A timestep of a layer, in which these spikes (B, M) of its synapses arrive.

        in_window: whether it is in its window, in which its bias axon spikes.
        """
        program, draws = self.program, self._draws
        now = layer if in_window else self._unbiased[layer.name]
        if draws is None:
            return program.chip.arithmetic.update(program, now, presynaptic, state)
        place = [each.name for each in program.layers].index(layer.name) + 1
        bits = program.chip.arithmetic.state_bits[-1]
        state.membrane = draws.flip(place, step, state.membrane, bits)
        result = program.chip.arithmetic.update(program, now, presynaptic, state)
        if not layer.spiking:
            return result
        return replace(result, spikes=draws.upset_spikes(place, step, result.spikes))

    def _presynaptic(
        self, layer: Layer, step: int, sent: Mapping[str, SpikeCounts]
    ) -> list[NDArray[Any]]:
        """Spikes (B, M) that arrive through each synapse of a layer in a chip timestep."""
        program, presynaptic = self.program, []
        for synapses in layer.synapses:
            source = synapses.source
            begin = 0 if source == program.input else program.begin(program.layer(source))
            presynaptic.append(sent[source][:, self._memory + step - synapses.delay - begin])
        return presynaptic

    def _dtype(self, name: str) -> type[np.integer[Any]]:
        return np.int64 if name in self.program.graded else np.uint8


def _without_bias(layer: Layer) -> Layer:
    """The layer while its bias axon is silent."""
    return replace(layer, bias=0 * layer.bias) if layer.bias.any() else layer


def _wait(state: LayerState) -> StepResult:
    """The timestep of a layer that has not started yet."""
    none = np.zeros(state.membrane.shape, np.int64)
    return StepResult(none, none.astype(np.bool_), none)


def _lengthen(tail: SpikeCounts, timesteps: int) -> SpikeCounts:
    batch, _, size = tail.shape
    return np.concatenate([tail, np.zeros((batch, timesteps, size), tail.dtype)], axis=1)


def _stack(
    results: Sequence[tuple[Numbers, Numbers, StepResult]], dtype: type[np.integer[Any]]
) -> LayerTrace:
    currents, membranes, steps = zip(*results, strict=True)
    lost = [step.lost for step in steps if step.lost is not None]
    return LayerTrace(
        current=np.stack(currents, axis=1),
        membrane=np.stack(membranes, axis=1),
        spikes=np.stack([step.spikes for step in steps], axis=1).astype(dtype),
        active=np.stack([step.active for step in steps], axis=1),
        overflows=np.stack([step.overflows for step in steps], axis=1),
        lost=np.stack(lost, axis=1) if lost else None,
    )


def count(
    program: Program,
    spikes: Mapping[str, SpikeCounts],
    traces: Mapping[str, LayerTrace] | None = None,
    waiting: Collection[str] = (),
) -> Counts:
    """Count the events (B, L, E) of one inference: the slow specification of a Machine's ledger.

    spikes: (B, T, N) of the input and of each layer that can spike, in all rows that they run; a
        graded one counts as one.
    traces: of each layer; None takes every neuron-timestep for an update, and no overflows.
    waiting: names of layers that have not started.
    """
    timesteps = spikes[program.input].shape[1]
    graded, rows = program.graded, {}
    for name, sent in spikes.items():
        rows[name] = (sent != 0 if name in graded else sent).sum(axis=1, dtype=np.int64)
    batch = len(rows[program.input])
    every = np.array([timesteps * layer.size for layer in program.layers])
    updates, overflows = np.tile(every, (batch, 1)), np.zeros((batch, len(every)), np.int64)
    lost = {}
    for k, (name, seen) in enumerate((traces or {}).items()):
        updates[:, k] = seen.active.sum(axis=(1, 2))
        overflows[:, k] = seen.overflows.sum(axis=(1, 2))
        if seen.lost is not None:
            lost[name] = seen.lost.sum(axis=1)
    windows = [
        len(range(timesteps)[program.window(a, timesteps)]) * (a.name not in waiting)
        for a in program.layers
    ]
    window_steps, steps = np.tile(windows, (batch, 1)), program.steps(timesteps)
    for layer in program.layers:
        rows.setdefault(layer.name, np.zeros((batch, layer.size), np.int64))
    return count_events(program, rows, updates, overflows, window_steps, steps, lost)


class InterpreterBackend:
    """An Interpreter as a Backend; a reset of states leaves the draws of upsets as they are."""

    def __init__(self, program: Program, schedule: Schedule, batch: int) -> None:
        self.schedule = schedule
        self._starts = {layer.name: layer.start for layer in program.layers}
        if streaming := schedule.mode == "step":
            # all layers start at once, so that lags are the delays of the chip
            layers = tuple(replace(layer, start=0) for layer in program.layers)
            program = replace(program, layers=layers, clock="pipelined")
        self._program, self._batch, self._streaming = program, batch, streaming
        self._lag = program.readout.lag if program.readout else 0
        self._waiting: set[str] = set()
        self._traces: dict[str, LayerTrace] = {}
        self._draws = UpsetDraws(program.upsets, batch) if program.upsets else None
        self.reset()

    @staticmethod
    def obstacle(program: Program) -> str | None:
        """Return None: every arithmetic is supported."""
        return None

    def reset(self) -> None:
        """Forget every current, membrane and spike."""
        self._interpreter = Interpreter(self._program, self._batch, self._draws)
        size = self._program.layer(self._program.output).size
        self._tail = np.zeros((self._lag, self._batch, size), np.uint8)

    def seed(self, seeds: Sequence[int]) -> None:
        """Start the draws of upsets anew, of an episode of each robot (B,)."""
        if self._draws is not None:
            self._draws.seed(seeds)

    @property
    def damage(self) -> tuple[Damage, ...]:
        """Hits of upsets so far."""
        return () if self._draws is None else self._draws.damage

    def run(self, rows: NDArray[Any], step: int | None = None) -> NDArray[Any]:
        """Spikes (T, B, N) as they reach the readout, from those of the input (T, B, M)."""
        draws = self._draws
        if draws is not None:
            rows = np.stack([draws.upset_spikes(0, t, row) for t, row in enumerate(rows)])
        check_counts(rows, self._program.chip.input_spikes_max)
        waits = self._streaming and step is not None
        self._waiting = {n for n, start in self._starts.items() if waits and (step or 0) < start}
        self._raster = rows.swapaxes(0, 1).astype(np.uint8)
        self._traces = self._interpreter.run(self._raster, self._waiting)
        late = np.concatenate([self._tail, self.spikes(self._program.output)])
        self._tail = late[len(rows) :]
        if draws is not None:
            draws.window += 1
        return late[: len(rows)]

    def report(self, ledger: LedgerBuilder) -> None:
        """Enter the last window in the ledger."""
        spikes = {self._program.input: self._raster}
        spikes |= {name: trace.spikes for name, trace in self._traces.items()}
        counts = count(self._program, spikes, self._traces, self._waiting)
        timesteps = self.schedule.timesteps
        ledger.add(counts, timesteps, self._program.steps(timesteps))

    def recordings(self) -> Mapping[str, Recording]:
        """The trace of each layer in the last window."""
        return self._traces

    def membranes(self, layer: str) -> NDArray[Any]:
        """Membranes (T, B, N) of a layer after each timestep of the last window [state units]."""
        return np.asarray(self._traces[layer].membrane.swapaxes(0, 1))

    def spikes(self, layer: str) -> NDArray[Any]:
        """Spikes (T, B, N) of a layer in the last window."""
        return np.asarray(self._traces[layer].spikes.swapaxes(0, 1))

    def states(self) -> dict[str, tuple[NDArray[Any], NDArray[Any]]]:
        """Current and membrane (B, N) of each layer; the current (B, K, N) where it has K."""
        states = self._interpreter.states
        return {name: (state.current, state.membrane) for name, state in states.items()}

    def saved(self) -> SavedState:
        """Copies of all states, of spikes on their way, and of the draws of upsets."""
        tails = {f"spikes of {name}": tail for name, tail in self._interpreter.tails.items()}
        found = {"readout": self._tail, **tails}
        for name, state in self._interpreter.states.items():
            found |= {f"{quantity} of {name}": values for quantity, values in vars(state).items()}
        if (draws := self._draws) is not None:
            found |= {"seeds": draws.seeds, "window": np.array(draws.window), "hits": draws.counts}
        return {name: values.copy() for name, values in found.items()}

    def restore(self, saved: SavedState) -> None:
        """Continue from there."""
        saved = {name: values.copy() for name, values in saved.items()}
        self._tail = saved["readout"]
        interpreter = self._interpreter
        interpreter.tails = {n: saved[f"spikes of {n}"] for n in interpreter.tails}
        for name, state in interpreter.states.items():
            for quantity in vars(state):
                setattr(state, quantity, saved[f"{quantity} of {name}"])
        if (draws := self._draws) is not None:
            draws.seed(saved["seeds"].tolist())
            draws.window, draws.counts = int(saved["window"]), saved["hits"]
