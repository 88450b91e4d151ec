"""The ledger: counted events of a chip, so that any table of energies can price it afterwards."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, Literal, Protocol, get_args

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.chips.layer import Layer
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.convention import Clock
from spikedeploy.runtime.copies import Copyable
from spikedeploy.runtime.errors import ConfigError

Counts = NDArray[np.int64]

EVENTS = (
    "spike_in",  # spikes sent to a layer
    "sop",  # synaptic operations: the non-zero fan-out of those spikes
    "bias_sop",  # synaptic operations of the always-on bias axon
    # neuron-timesteps with a membrane, a current or a bias to add up; event by event, each neuron
    # that an event reached
    "neuron_update",
    "neuron_idle",  # neuron-timesteps without; a chip still looks at the neuron
    "spike_out",  # spikes that a layer emits; a readout layer emits none
    # packets to a layer: spikes, the bias axon's; and from it to the host: spikes of an output
    # layer, and of a readout layer the membrane of each neuron in each timestep
    "message",
    "saturation",  # numbers that did not fit the accumulator, a current or a membrane
    "graded_sop",  # those of the synaptic operations that multiply a weight by a graded spike
    "lost_spike",  # spikes of a layer that found the chip's queue full and reached no neuron
)


def _column(event: str) -> int:
    """The place of an event in EVENTS; ConfigError for others."""
    if event not in EVENTS:
        raise ConfigError(f"event {event!r} is unknown. Choose one of {', '.join(EVENTS)}.")
    return EVENTS.index(event)


@dataclass(frozen=True, eq=False)
class Ledger:
    """Counts of events.

    layers: names, L.
    neurons: of each layer.
    counts: (S, L, E) per control step; E as in EVENTS. One row when only totals are kept.
    inferences: how many the rows sum up.
    timesteps: network updates of each layer in all of them.
    steps: chip timesteps in all of them, those that only fill the pipeline included.
    several: whether a neuron can spike several times in a timestep.
    clock: how the layers advanced, as in Program.
    assumed_clock: whether nothing says that the chip can advance them so.
    readouts: names of the layers that never spike, which sparsity leaves out.
    one_state: names of the layers whose neurons hold one state: a membrane, and no current.
    """

    layers: tuple[str, ...]
    neurons: tuple[int, ...]
    counts: Counts
    inferences: int
    timesteps: int
    steps: int
    several: bool = False
    clock: Clock = "gated"
    assumed_clock: bool = False
    readouts: tuple[str, ...] = ()
    one_state: tuple[str, ...] = ()

    def total(self, event: str) -> int:
        """All events of a kind, over steps and layers."""
        return int(self.counts[:, :, _column(event)].sum())

    def per_inference(self, event: str) -> float:
        """Mean number of events of a kind in an inference."""
        return self.total(event) / max(self.inferences, 1)

    def by_layer(self, event: str) -> dict[str, int]:
        """All events of a kind, of each layer."""
        totals = self.counts[:, :, _column(event)].sum(axis=0)
        return dict(zip(self.layers, totals.tolist(), strict=True))

    def of_layer(self, name: str) -> "Ledger":
        """Counts of one layer alone."""
        place = self.layers.index(name)
        return replace(
            self,
            layers=(name,),
            neurons=self.neurons[place : place + 1],
            counts=self.counts[:, place : place + 1],
            readouts=tuple(each for each in self.readouts if each == name),
            one_state=tuple(each for each in self.one_state if each == name),
        )

    def since(self, before: "Ledger") -> "Ledger":
        """Counts since an earlier ledger of the same network, in one row."""
        now, then = (each.counts.sum(axis=0, keepdims=True) for each in (self, before))
        return replace(
            self,
            counts=now - then,
            inferences=self.inferences - before.inferences,
            timesteps=self.timesteps - before.timesteps,
            steps=self.steps - before.steps,
        )

    @property
    def sparsity(self) -> float | None:
        """Part of all neuron-timesteps without a spike (NeuroBench's ActivationSparsity).

        Of neurons that can spike: readouts never do, and would flatter. None where no neuron can,
        and where neurons spike several times in one, as counts do not tell in how many.
        """
        sizes = dict(zip(self.layers, self.neurons, strict=True))
        spiking = [size for name, size in sizes.items() if name not in self.readouts]
        if self.several or not spiking:
            return None
        every = max(sum(spiking) * self.timesteps, 1)
        return (every - self.total("spike_out")) / every


def count_events(
    program: Program,
    spikes: Mapping[str, NDArray[Any]],
    updates: Counts,
    overflows: Counts,
    window_steps: Counts,
    steps: int,
    lost: Mapping[str, NDArray[Any]] = MappingProxyType({}),
) -> Counts:
    """Count the events (S, L, E) that follow from the activity of neurons in S windows.

    spikes: (S, N) of each neuron of the input and of each layer.
    updates, overflows: (S, L) neuron-timesteps with something to add up; numbers that did not fit.
    window_steps: (S, L) timesteps in which a layer's bias axon spikes and the host reads it.
    steps: chip timesteps of a window.
    lost: (S, N) of the spikes of some layers those that reached no neuron.
    """
    counts = np.zeros((*updates.shape, len(EVENTS)), np.int64)
    arriving = {name: rows - lost[name] if name in lost else rows for name, rows in spikes.items()}
    sent = {name: rows.sum(axis=1, dtype=np.int64) for name, rows in spikes.items()}
    lost_counts = {name: rows.sum(axis=1) for name, rows in lost.items()}
    by_events = program.chip.arithmetic.by_events
    for k, layer in enumerate(program.layers):
        # float64 is exact up to 2**53, and has the matrix product that int64 lacks
        operations = {
            s: (arriving[s.source] @ s.fan_out.astype(np.float64)).astype(np.int64)
            for s in layer.synapses
        }
        spike_in = sum(sent[s.source] - lost_counts.get(s.source, 0) for s in layer.synapses)
        leaving = sent[layer.name] if layer.spiking else window_steps[:, k] * layer.size
        has_bias = layer.bias_fan_out > 0
        events = {
            "spike_in": spike_in,
            "sop": sum(operations.values()),
            "bias_sop": window_steps[:, k] * layer.bias_fan_out,
            "neuron_update": updates[:, k],
            "neuron_idle": 0 if by_events else layer.size * steps - updates[:, k],
            "spike_out": sent[layer.name] * layer.spiking,
            "message": spike_in
            + window_steps[:, k] * has_bias
            + leaving * (layer.name in program.output_layers),
            "saturation": overflows[:, k],
            "graded_sop": sum(n for s, n in operations.items() if s.source in program.graded),
            "lost_spike": lost_counts.get(layer.name, 0),
        }
        for kind, name in enumerate(EVENTS):
            counts[:, k, kind] = events[name]
    return counts


def state_count(layer: Layer, program: Program) -> int:
    """Count the states of a neuron: those of the chip, without a current that decays at once.

    A current that keeps nothing from one timestep to the next needs no memory of its own.
    """
    kinds = len(program.chip.arithmetic.state_bits)
    return 1 if not np.any(layer.current_decay) else kinds


Rows = Literal["each", "copies", "total", "none"]

# observations that wait to be counted: many are counted in little more time than one
_PENDING = 64


class _Counter(Protocol):
    """Counts the events of many windows at once.

    batch: B.
    timesteps, steps: of a window, in a layer and in the chip.
    """

    batch: int
    timesteps: int
    steps: int

    def count(self, observations: Sequence[Any]) -> Counts:
        """Counts (S, L, E): a row for each observation and each of its batch."""


class LedgerBuilder(Copyable):
    """Rows of counts, from observations that are counted when there are enough of them.

    rows: "each" keeps a row per control step, of each of a batch; "copies" adds up those of each;
        "total" adds up all; "none" keeps nothing.
    """

    def __init__(self, program: Program, rows: Rows = "each") -> None:
        if rows not in get_args(Rows):
            known = ", ".join(map(repr, get_args(Rows)))
            raise ConfigError(f"ledger {rows!r} is unknown. Choose one of {known}.")
        self.rows = rows
        self._program = program
        self._counts = np.zeros((1, len(program.layers), len(EVENTS)), np.int64)
        self._used = self._inferences = self._timesteps = self._steps = 0
        self._pending: list[Any] = []
        self._counter: _Counter | None = None

    def __getstate__(self) -> dict[str, Any]:
        """Return the state with all pending events counted, as their counter shares memory."""
        self._count()
        return {**vars(self), "_counter": None}

    @property
    def keeps(self) -> bool:
        """True if rows are recorded."""
        return self.rows != "none"

    def observe(self, counter: _Counter, observation: Any) -> None:  # noqa: ANN401
        """Record what a counter needs of one inference, or step, of a batch."""
        if counter is not self._counter:
            self._count()
            self._counter = counter
        self._pending.append(observation)
        if len(self._pending) * counter.batch >= _PENDING:
            self._count()

    def add(self, counts: Counts, timesteps: int, steps: int) -> None:
        """Add counts (B, L, E) of a window of so many timesteps of a layer, and of the chip."""
        self._count()
        self._append(counts, len(counts), timesteps, steps)

    def ledger(self) -> Ledger:
        """The ledger of everything recorded so far."""
        self._count()
        return Ledger(
            layers=tuple(layer.name for layer in self._program.layers),
            neurons=tuple(layer.size for layer in self._program.layers),
            counts=self._counts[: self._used].copy(),
            inferences=self._inferences,
            timesteps=self._timesteps,
            steps=self._steps,
            several=self._program.chip.spikes_max > 1,
            clock=self._program.clock,
            assumed_clock=self._program.assumed_clock,
            readouts=tuple(a.name for a in self._program.layers if not a.spiking),
            one_state=tuple(
                a.name for a in self._program.layers if state_count(a, self._program) == 1
            ),
        )

    def _count(self) -> None:
        if self._counter and self._pending:
            pending, self._pending = self._pending, []
            counts = self._counter.count(pending)
            self._append(counts, self._counter.batch, self._counter.timesteps, self._counter.steps)

    def _append(self, counts: Counts, batch: int, timesteps: int, steps: int) -> None:
        rows = len(counts)
        self._inferences += rows
        self._timesteps += rows * timesteps
        self._steps += rows * steps
        if self.rows == "total":
            # into the memory that is there: a machine may run a thousand times a second
            for row in counts:
                np.add(self._counts[0], row, self._counts[0])
            self._used = 1
            return
        if self.rows == "copies" and self._used:
            if self._used != batch:
                raise ConfigError(f"ledger 'copies' has {self._used} copies, found {batch}.")
            kept = self._counts[:batch]
            kept += counts.reshape(-1, *kept.shape).sum(axis=0)
            return
        if self.rows == "copies":
            counts = counts.reshape(-1, batch, *counts.shape[1:]).sum(axis=0)
        end = self._used + len(counts)
        if end > len(self._counts):
            grown = np.zeros((2 * end, *self._counts.shape[1:]), np.int64)
            grown[: self._used] = self._counts[: self._used]
            self._counts = grown
        self._counts[self._used : end] = counts
        self._used = end
