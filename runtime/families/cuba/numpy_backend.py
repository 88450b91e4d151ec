"""The NumPy backend: a layer's window of timesteps in few calls, equal to the interpreter.

States are float64, which holds 24-bit states and their products with 12-bit decays exactly, and
needs two calls where integers need five: trunc(x * decay) is the decay toward zero. Overflow is not
checked in every timestep: either the bounds prove that no number can be too large, or the states
are looked at afterwards. A window that did overflow, which is rare, is computed once more by the
interpreter.

Spikes become sums of weights by a product of all axons, by one of those alone that spike, or row by
row, of which a fixed rule on their density chooses. All sum whole numbers that their number type is
proven to hold exactly, so they agree bit for bit, in any order of summation and on any BLAS.
(`ideal` has no whole numbers and always multiplies in float64, timesteps and batch in one matrix.)
"""

from collections.abc import Callable, Iterable, Sequence
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.chips.layer import Layer, LayerState, Recording, Synapses
from spikedeploy.runtime.chips.registers import magnitude
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.copies import NotCopyable
from spikedeploy.runtime.emulator.backend import (
    SavedState,
    Schedule,
    aligned_copy,
    aligned_zeros,
    check_counts,
    concatenate_recordings,
    unsupported_synapses,
)
from spikedeploy.runtime.emulator.ledger import EVENTS, Counts, LedgerBuilder, count_events
from spikedeploy.runtime.families.cuba.arithmetic import CubaFixedPoint
from spikedeploy.runtime.families.cuba.neurons import update
from spikedeploy.runtime.families.cuba.quantise import bounds, register_limit

Numbers = NDArray[Any]


class Raster:
    """Spikes (T, B, M) of one source in a window, and counts of them, each found once.

    rows: uint8 or bool, 0 or 1.
    bits: `rows` in bool, on which NumPy searches and counts faster than on numbers.
    """

    __slots__ = ("_axons", "_spikes", "bits", "rows")

    def __init__(self, rows: Numbers) -> None:
        self.rows = rows
        self.bits = rows.view(np.bool_) if rows.dtype.itemsize == 1 else rows.astype(np.bool_)
        self._axons: NDArray[np.intp] | None = None
        self._spikes = -1

    def spikes(self) -> int:
        """Number of spikes."""
        if self._spikes < 0:
            self._spikes = int(np.count_nonzero(self.bits))
        return self._spikes

    def axons(self) -> NDArray[np.intp]:
        """Indices of the axons that spiked at least once; batch 1."""
        if self._axons is None:
            self._axons = np.logical_or.reduce(self.bits.squeeze(1), 0).nonzero()[0]
        return self._axons


# largest magnitude up to which every whole number is held
_EXACT_FLOAT32 = 1 << 24

# the rule, from measurements: at batch 1, matrices of at least so many weights are multiplied by
# the axons alone that spike in the window, while those are no larger a part of all
SPARSE_WEIGHTS = 1 << 15
SPARSE_SHARE = 0.4
# else rows are added one by one, in matrices of at least so many weights, while an axon that spikes
# does so no more often in the mean
LARGE_WEIGHTS = 1 << 17
FEW_SPIKES = 2.5


class Summation:
    """The sums of the weights that a raster brings, those of the bias included [state units].

    weight: (M, N).
    bias: (N,) weights of the axon that always spikes; (T, 1, N) where it does not always.
    partial: largest magnitude of any partial sum; None where weights are no whole numbers.
    unit: state units per weight unit.
    out: (T, B, N) where the sums are wanted.
    scratch: memory for as many float64 as there are weights, in which nothing lasts.
    """

    def __init__(
        self,
        weight: Numbers,
        bias: Numbers,
        partial: int | None,
        unit: int,
        out: Numbers,
        scratch: Numbers,
    ) -> None:
        timesteps, batch, neurons = out.shape
        exact32 = partial is not None and partial * unit < _EXACT_FLOAT32
        dtype = np.dtype(np.float32 if exact32 else np.float64)
        self.weight = aligned_copy(weight * float(unit), dtype)
        self._spikes = aligned_zeros((timesteps, batch, len(weight)), dtype)
        # BLAS wants two axes, and the place itself if its number type is that of the weights
        self._out = out.reshape(-1, neurons)
        self._sums = self._out if out.dtype == dtype else aligned_zeros(self._out.shape, dtype)
        # arrays of one shape are added in half the time
        copies = np.broadcast_to(bias * float(unit), out.shape).reshape(self._sums.shape)
        self._bias = copies.astype(dtype) if bias.any() else None
        self.is_dense = partial is None or batch > 1 or weight.size < SPARSE_WEIGHTS
        self._fetched = scratch[: self.weight.nbytes].view(dtype).reshape(weight.shape)

    def __call__(self, raster: Raster) -> None:
        """Write the sums, by the way that the density of the spikes makes fastest."""
        if self.is_dense:
            self.multiply(raster)
        elif (active := len(raster.axons())) <= SPARSE_SHARE * len(self.weight):
            self.multiply_active(raster)
        elif self.weight.size >= LARGE_WEIGHTS and raster.spikes() <= FEW_SPIKES * active:
            self.add_rows(raster)
        else:
            self.multiply(raster)

    def multiply(self, raster: Raster) -> None:
        """Multiply all axons by all weights: one matrix product for the window."""
        np.copyto(self._spikes, raster.rows)
        self._spikes.reshape(-1, len(self.weight)).dot(self.weight, self._sums)
        self._finish()

    def multiply_active(self, raster: Raster) -> None:
        """Multiply only the weights of axons that spiked, in one small product; batch 1.

        Best where the same axons spike again and again, as those of a population code do.
        """
        axons = raster.axons()
        spikes = raster.rows.squeeze(1).take(axons, 1).astype(self.weight.dtype)
        # "clip" never has anything to clip here, and needs no second buffer
        weight = self.weight.take(axons, 0, self._fetched[: len(axons)], "clip")
        spikes.dot(weight, self._sums)
        self._finish()

    def add_rows(self, raster: Raster) -> None:
        """Add the weights of axons that spiked, timestep by timestep; batch 1."""
        for spikes, sums in zip(raster.bits.squeeze(1), self._sums, strict=True):
            axons = spikes.nonzero()[0]
            weight = self.weight.take(axons, 0, self._fetched[: len(axons)], "clip")
            np.add.reduce(weight, 0, None, sums)
        self._finish()

    def _finish(self) -> None:
        if self._bias is not None:
            np.add(self._sums, self._bias, self._sums)
        if self._sums is not self._out:
            np.copyto(self._out, self._sums)


class KernelSummation:
    """The sums of synapses with a window, which chooses between scattering and unfolding."""

    def __init__(self, synapses: Synapses, bias: Numbers, unit: int, out: Numbers) -> None:
        self._synapses, self._unit, self._out = synapses, float(unit), out
        self._bias = bias * float(unit)

    def __call__(self, raster: Raster) -> None:
        """Write the sums."""
        np.multiply(self._synapses.sums(raster.rows), self._unit, self._out)
        np.add(self._out, self._bias, self._out)


class LayerWindow:
    """One layer, ready to run windows of T timesteps for a batch of B, in the same memory.

    fixed: the integers of the chip; None computes in float64.
    biased: rows of a window in which the bias axon spikes.
    states: (T + 1, 2, B, N) current and membrane, before the window and after each timestep.
    bias: (B, N) that is added to the membranes; None where all are 0.
    spikes: (T, B, N) of the last window.
    overflows: (B,) numbers that did not fit their register in it; None where all did.
    is_waiting: True where the layer had not started in it.
    """

    def __init__(
        self,
        program: Program,
        layer: Layer,
        fixed: CubaFixedPoint | None,
        shape: tuple[int, int],
        kept: bool,
        scratch: Numbers,
        biased: slice,
    ) -> None:
        self._program, self.layer, self._fixed, self._kept = program, layer, fixed, kept
        timesteps, batch = shape
        self.spikes = np.zeros((timesteps, batch, layer.size), np.bool_)
        self.overflows: Counts | None = None
        self.is_waiting = False
        self.states = aligned_zeros((timesteps + 1, 2, batch, layer.size), np.float64)
        self._refractory = np.zeros((batch, layer.size), np.int64)
        self._sums = aligned_zeros(self.spikes.shape, np.float64)
        partial = None
        if fixed:
            # of a window from zero, or of states that are kept
            partial = self._prepare_check(fixed, None if kept else timesteps)
        self._unit = 1 << fixed.mantissa_shift if fixed else 1
        self._more = aligned_zeros(self._sums.shape, np.float64)
        bias = layer.bias
        if range(timesteps)[biased] != range(timesteps):
            bias = np.zeros((timesteps, 1, layer.size), layer.bias.dtype)
            bias[biased] = layer.bias
        summations: list[Summation | KernelSummation] = []
        for k, s in enumerate(layer.synapses):
            added, out = (0 * layer.bias, self._more) if k else (bias, self._sums)
            summations.append(
                Summation(s.weight, added, partial, self._unit, out, scratch)
                if s.window is None
                else KernelSummation(s, added, self._unit, out)
            )
        self._first, *self._others = summations
        self._prepare_update(layer, fixed)

    def _prepare_check(self, fixed: CubaFixedPoint, timesteps: int | None) -> int:
        """Prepare the test for overflows; return the largest partial sum of weights."""
        layer, limits = self.layer, bounds(self._program, self.layer, fixed, timesteps)
        self._limit = limit = min(register_limit(fixed.current), register_limit(fixed.membrane))
        self._push = float(layer.voltage_bias.max(initial=0))
        self._open = max(limits.current, limits.above, limits.below) > limit
        # membranes that no spike resets are all kept, and looked at as they are
        self._open_above = layer.spiking and limits.above > limit
        pushed = min(limits.current, register_limit(fixed.current)) + magnitude(layer.voltage_bias)
        # refractory, and accumulators and pushes that overflow, are left to the interpreter
        self._never = (
            fixed.refractory > 1
            or limits.drive > register_limit(fixed.accumulator)
            or pushed > register_limit(fixed.push)
        )
        return limits.partial

    def _prepare_update(self, layer: Layer, fixed: CubaFixedPoint | None) -> None:
        """Views of the memory of each timestep, for the fewest and shortest calls of NumPy."""
        # where nothing stays of a current, it is what arrives, and only the membrane decays
        self._has_current = bool(layer.current_decay.any())
        decaying = slice(0 if self._has_current else 1, 2)
        # (2, 1, N): one multiplication decays currents and membranes
        factors = np.stack([layer.current_decay, layer.membrane_decay])[decaying, None]
        self._decay = factors / float(fixed.decay_one if fixed else 1)
        # arrays of one shape take NumPy's shortest way; a (N,) beside a (1, N) costs half a us more
        shape, states = self.spikes[0].shape, self.states
        self._threshold = np.broadcast_to(layer.threshold.astype(np.float64), shape).copy()
        bias = np.broadcast_to(layer.voltage_bias.astype(np.float64), shape).copy()
        self.bias = bias if bias.any() else None
        self._timesteps = [
            (states[t, decaying], states[t + 1, decaying], *states[t + 1], self._sums[t], spikes)
            for t, spikes in enumerate(self.spikes)
        ]
        self._reset_spiking: Callable[[Numbers, Numbers, Any], None] = np.putmask
        self._to: Any = np.zeros(1)
        if self._program.convention.reset == "subtract":
            self._reset_spiking, self._to = _subtract, self._threshold

    def reset(self) -> None:
        """Forget the state."""
        self.states[-1] = 0.0
        self._refractory[:] = 0

    def run(self, presynaptic: Sequence[Raster]) -> Raster:
        """Spikes of the window, from those that arrive through each synapses of the layer."""
        self.is_waiting = False
        if self._kept:
            self.states[0] = self.states[-1]
        self._first(presynaptic[0])
        for index, summation in enumerate(self._others, start=1):
            summation(presynaptic[index])
            np.add(self._sums, self._more, self._sums)
        self._update()
        self.overflows = None
        if self._fixed and not self._fits():
            self._interpret(self._fixed)
        return Raster(self.spikes)

    def wait(self) -> Raster:
        """Return no spikes, because the layer has not started."""
        self.is_waiting = True
        self.spikes.fill(False)
        return Raster(self.spikes)

    def saved(self) -> SavedState:
        """Copies of the states, and of the timesteps of refractory left."""
        return {"states": self.states[-1].copy(), "refractory": self._refractory.copy()}

    def restore(self, saved: SavedState) -> None:
        """Continue from there."""
        self.states[-1] = saved["states"]
        self._refractory = saved["refractory"].copy()

    def _update(self) -> None:
        """Fill states and spikes, one timestep after another."""
        # names of the function are found faster than those of the module
        multiply, trunc, add, greater = np.multiply, np.trunc, np.add, np.greater
        decay, threshold, bias = self._decay, self._threshold, self.bias
        reset, to = self._reset_spiking, self._to
        has_current, rounds, resting = self._has_current, self._fixed is not None, not self._kept
        for before, after, current, membrane, drive, spikes in self._timesteps:
            if resting:
                # from zero, both states become what arrives
                np.copyto(after, drive)
                resting = False
            else:
                multiply(before, decay, after)
                if rounds:
                    trunc(after, after)
                if has_current:
                    add(current, drive, current)
                    add(membrane, current, membrane)
                else:
                    add(membrane, drive, membrane)
            if bias is not None:
                add(membrane, bias, membrane)
            greater(membrane, threshold, spikes)
            reset(membrane, spikes, to)
        if not has_current:
            np.copyto(self.states[1:, 0], self._sums)

    def _fits(self) -> bool:
        """True where no register overflowed in the window; False may be a false alarm.

        What the bounds prove costs nothing; where they leave something open, the largest and the
        smallest state are looked for.
        """
        if self._never or not self._open:
            return not self._never
        # what max() and min() do, without their overhead in Python
        highest = float(np.maximum.reduce(self.states, axis=None))
        lowest = float(np.minimum.reduce(self.states, axis=None))
        if self._open_above:
            # a membrane before its reset is not kept, but cannot have been higher than this: what
            # the one before left, and the current
            highest = 2 * max(highest, 0.0) + self._push
        return -self._limit <= lowest and highest <= self._limit

    def _interpret(self, fixed: CubaFixedPoint) -> None:
        """Compute the window again by the specification."""
        before = self.states[0].astype(np.int64)
        state = LayerState(before[0], before[1], self._refractory)
        self.overflows = np.zeros(before.shape[1], np.int64)
        for row, weights in enumerate(np.asarray(self._sums / self._unit, np.int64)):
            result = update(fixed, self._program.convention, self.layer, weights, state)
            self.states[row + 1] = state.current, state.membrane
            self.spikes[row] = result.spikes
            self.overflows += result.overflows.sum(axis=1)
        if self._kept:
            self._refractory = state.refractory


def _subtract(membrane: Numbers, spikes: Numbers, threshold: Numbers) -> None:
    np.subtract(membrane, threshold, out=membrane, where=spikes)


# of a window: spikes (B, N) of the input and of each layer; and of each layer neuron-timesteps (B,)
# with something to add up, numbers (B,) that did not fit if any, and True where it has started
Observation: TypeAlias = tuple[list[Numbers], list[tuple[Any, Counts | None, bool]]]


class EventCounter:
    """A counter of the events of windows; many windows cost little more time than one.

    windows: of the layers, in their order.
    window_steps: of each layer the timesteps in which its bias axon spikes and the host reads it.
    timesteps: of a window.
    steps: chip timesteps that it stands for, those in which a layer only waits included.
    """

    def __init__(
        self,
        program: Program,
        windows: Sequence[LayerWindow],
        window_steps: Sequence[int],
        timesteps: int,
        steps: int,
    ) -> None:
        self.timesteps, self.steps, self.batch = timesteps, steps, windows[0].states.shape[2]
        self._program, self._window_steps = program, np.array(window_steps)
        # views that are made once
        nonzero = [np.empty(window.states.shape, np.bool_) for window in windows]
        self._windows = [
            (window, n, n[1:, 0], n[:-1, 1]) for window, n in zip(windows, nonzero, strict=True)
        ]

    def observe(self, output_spikes: Iterable[Raster]) -> Observation:
        """The windows that have just run, with the spikes of the input and of each layer."""
        # eight bits hold the counts of a short window, and are summed several times faster
        dtype = np.uint8 if self.timesteps < 256 else np.int64
        spikes = [np.add.reduce(raster.rows, 0, dtype) for raster in output_spikes]
        return spikes, [self._count_active(*each) for each in self._windows]

    def count(self, observations: Sequence[Observation]) -> Counts:
        """Counts (S, L, E): a row for each observation and each of its batch."""
        spikes = zip(*[sources for sources, _ in observations], strict=True)
        layers = [each for _, layers in observations for each in layers]
        none = np.zeros(self.batch, np.int64)
        running = self._rows([none + is_running for _, _, is_running in layers])
        return count_events(
            self._program,
            dict(zip(self._program.sizes, map(np.concatenate, spikes), strict=True)),
            self._rows([updates for updates, _, _ in layers]) * running,
            self._rows([none if lost is None else lost for _, lost, _ in layers]) * running,
            self._window_steps * running,
            self.steps,
        )

    def _rows(self, values: Sequence[Any]) -> Counts:
        """Values of observations, layers and batch as rows (S, L)."""
        shaped = np.array(values, np.int64).reshape(-1, len(self._window_steps), self.batch)
        return np.asarray(shaped.swapaxes(1, 2).reshape(-1, len(self._window_steps)))

    def _count_active(
        self, window: LayerWindow, nonzero: Numbers, active: Numbers, before: Numbers
    ) -> tuple[Any, Counts | None, bool]:
        """Neuron-timesteps with a membrane, a current or a bias, and how the window went."""
        np.not_equal(window.states, 0.0, nonzero)
        np.logical_or(active, before, active)
        if window.bias is not None:
            np.logical_or(active, window.bias, active)
        # without axes it is far faster
        updates = np.count_nonzero(active) if self.batch == 1 else np.count_nonzero(active, (0, 2))
        return updates, window.overflows, not window.is_waiting


_IDLE = EVENTS.index("neuron_idle")


class NumpyPipeline(NotCopyable):
    """CuBa-LIF layers as a Backend; integers where the chip has them, else float64."""

    instead = "Copy the Machine."

    def __init__(self, program: Program, schedule: Schedule, batch: int) -> None:
        self.schedule = schedule
        self._program, self._most = program, program.chip.input_spikes_max
        numbers, whole = program.chip.arithmetic, schedule.mode == "window"
        fixed = numbers if isinstance(numbers, CubaFixedPoint) else None
        self._dtype = np.int64 if fixed else np.float64
        # rows that a layer runs at once
        self._rows = rows = schedule.timesteps if whole else 1
        spans = [program.window(a, rows) if whole else slice(None) for a in program.layers]
        synapses = [s for layer in program.layers for s in layer.synapses]
        largest = max((s.weight.size for s in synapses if s.window is None), default=0)
        scratch = aligned_zeros((largest * np.dtype(np.float64).itemsize,), np.uint8)
        self._windows = {
            layer.name: LayerWindow(
                program, layer, fixed, (rows, batch), schedule.kept, scratch, biased
            )
            for layer, biased in zip(program.layers, spans, strict=True)
        }
        self._counter = EventCounter(
            program,
            [*self._windows.values()],
            [len(range(rows)[biased]) for biased in spans],
            rows,
            schedule.steps if whole else 1,
        )
        self._output_spikes: dict[str, Raster] = {}
        # of each row, where rows run one by one
        self._observed: list[Observation] = []
        self._recorded: list[dict[str, Recording]] = []
        # a layer, and the sources of its synapses with the rows that they are late
        self._route = [
            (window, [(s.source, delay) for s, delay in zip(a.synapses, delays, strict=True)])
            for a, window, delays in zip(
                program.layers, self._windows.values(), schedule.delays, strict=True
            )
        ]
        self._lag = program.readout.lag if program.readout else 0
        self._longest = max(self._lag, *(max(delays) for delays in schedule.delays))
        # the last rows of each source, some of which have not arrived yet
        self._tails = {
            name: np.zeros((self._longest, batch, n), np.uint8) for name, n in program.sizes.items()
        }

    @staticmethod
    def obstacle(program: Program) -> str | None:
        """The reason why it cannot compute the program; None where it can."""
        if program.clock == "free" and not program.feed_forward:
            for layer in program.layers:
                if layer.bias.any() or not layer.spiking:
                    return (
                        f"layer {layer.name!r}: its bias axon, or the host, has a window of its "
                        "own while layers run free; in a network with loops, which is computed "
                        "row by row, only the interpreter and Numba support that."
                    )
        return unsupported_synapses(program)

    def reset(self) -> None:
        """Forget every current, membrane and spike."""
        for tail in self._tails.values() if self._longest else ():
            tail.fill(0)
        if self.schedule.kept:
            for window in self._windows.values():
                window.reset()

    def run(self, rows: Numbers, step: int | None = None) -> Numbers:
        """Spikes (T, B, N) as they reach the readout, from those of the input (T, B, M)."""
        check_counts(rows, self._most)
        if self.schedule.mode != "row":
            return self._run(rows, step)
        # all layers for one row after another, which closes loops
        self._observed, self._recorded, arrived = [], [], []
        for row in rows:
            # the windows use their memory again for the next row
            arrived.append(self._run(row[None], None).copy())
            if self.schedule.counting:
                self._observed.append(self._counter.observe(self._output_spikes.values()))
            if self.schedule.trace:
                self._recorded.append(self._recordings())
        return np.concatenate(arrived)

    def report(self, ledger: LedgerBuilder) -> None:
        """Enter the last window in the ledger."""
        if self.schedule.mode != "row":
            ledger.observe(self._counter, self._counter.observe(self._output_spikes.values()))
            return
        timesteps, steps = self.schedule.timesteps, self.schedule.steps
        counts = self._counter.count(self._observed)
        total = counts.reshape(timesteps, -1, *counts.shape[1:]).sum(axis=0)
        total[:, :, _IDLE] += [(steps - timesteps) * a.size for a in self._program.layers]
        ledger.add(total, timesteps, steps)

    def recordings(self) -> dict[str, Recording]:
        """A recording of the last window of each layer."""
        if self._recorded:
            return concatenate_recordings(self._recorded, axis=1)
        return self._recordings()

    def membranes(self, layer: str) -> Numbers:
        """Membranes (T, B, N) of a layer after each timestep of the last window [state units]."""
        if self._recorded:
            return np.stack([recorded[layer].membrane[:, 0] for recorded in self._recorded])
        return self._windows[layer].states[1:, 1]

    def spikes(self, layer: str) -> Numbers:
        """Spikes (T, B, N) of a layer in the last window."""
        if self._recorded:
            return np.stack([recorded[layer].spikes[:, 0] for recorded in self._recorded])
        return self._output_spikes[layer].rows

    def states(self) -> dict[str, tuple[Numbers, Numbers]]:
        """Current and membrane (B, N) of each layer."""
        now = {name: each.states[-1].astype(self._dtype) for name, each in self._windows.items()}
        return {name: (both[0], both[1]) for name, both in now.items()}

    def saved(self) -> SavedState:
        """Copies of all states, and of the spikes that have not arrived yet."""
        saved = {f"spikes of {name}": tail.copy() for name, tail in self._tails.items()}
        for layer, window in self._windows.items():
            saved |= {f"{name} of {layer}": values for name, values in window.saved().items()}
        return saved

    def restore(self, saved: SavedState) -> None:
        """Continue from there."""
        self._tails = {name: saved[f"spikes of {name}"].copy() for name in self._tails}
        for layer, window in self._windows.items():
            window.restore({name: saved[f"{name} of {layer}"] for name in window.saved()})

    def _run(self, rows: Numbers, step: int | None) -> Numbers:
        """Run each layer once, for all rows."""
        self._output_spikes = sent = {self._program.input: Raster(rows)}
        late = self._late_rows
        for window, synapses in self._route:
            if step is not None and step < window.layer.start:
                sent[window.layer.name] = window.wait()
                continue
            # in most networks nothing is late
            presynaptic = [
                late(source, delay) if delay else sent[source] for source, delay in synapses
            ]
            sent[window.layer.name] = window.run(presynaptic)
        output = self._program.output
        arriving = (late(output, self._lag) if self._lag else sent[output]).rows
        if self._longest:
            for name, raster in sent.items():
                kept = np.concatenate([self._tails[name], raster.rows])
                self._tails[name] = kept[-self._longest :]
        return arriving

    def _late_rows(self, source: str, delay: int) -> Raster:
        """The rows of a source that arrive in this window, at least one row late."""
        first, timesteps = self._longest - delay, self._rows
        rows = self._tails[source][first : first + timesteps]
        if delay < timesteps:
            now = self._output_spikes[source].rows[: timesteps - delay]
            rows = np.concatenate([rows, now])
        return Raster(rows)

    def _recordings(self) -> dict[str, Recording]:
        """A recording of each layer's last run."""
        recordings = {}
        for name, window in self._windows.items():
            # (T + 1, 2, B, N) to (2, B, T, N)
            current, membrane = window.states[1:].transpose(1, 2, 0, 3).astype(self._dtype)
            spikes = window.spikes.swapaxes(0, 1).astype(np.uint8)
            recordings[name] = Recording(current, membrane, spikes)
        return recordings
