"""A running chip that works event by event: ordered events in, ordered spikes of its layers out.

`EventMachine` streams: events come in parts of any length, states continue from part to part, and
little memory is needed. `EventPipeline` runs the same in timesteps, for a Machine: a
timestep's counts are single events, in the order in which spikes leave.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from importlib.util import find_spec
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.chips.layer import LayerState, Network, StepResult
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.copies import Copyable
from spikedeploy.runtime.emulator.backend import BackendName, Schedule, backend_class
from spikedeploy.runtime.emulator.interpreter import InterpreterBackend
from spikedeploy.runtime.emulator.ledger import Ledger, LedgerBuilder, count_events
from spikedeploy.runtime.errors import ConfigError, ObservationError
from spikedeploy.runtime.families.integrate_and_fire import numba_events
from spikedeploy.runtime.families.integrate_and_fire.arithmetic import IntegrateAndFire
from spikedeploy.runtime.families.integrate_and_fire.event_queues import (
    EventNetwork,
    OrderedSpikes,
    process_queue,
    update_by_events,
)
from spikedeploy.runtime.families.numba_pipeline import edges

# events of the input whose spikes are computed at once
_PART = 1 << 12


class EventMachine(Copyable):
    """A running program of a chip that works event by event, such as speck2f:queue=on.

    program: what it runs.
    backend: "auto" takes the compiled kernels where Numba is installed; "numba" requires them;
        "interpreter" is their specification, equal and slow, as "numpy" is here.
    """

    def __init__(self, program: Program, backend: BackendName = "auto") -> None:
        rules = program.chip.arithmetic
        if not isinstance(rules, IntegrateAndFire) or not rules.by_events:
            raise ConfigError(
                f"chip {program.chip.name!r} does not go event by event. Compile for "
                "speck2f:queue=on, or give the events as counts of timesteps to a Machine."
            )
        compiled = backend_class(program, backend) is EventPipeline
        self.program = program
        self._rules, self._process = (
            rules,
            numba_events.process_queue if compiled else process_queue,
        )
        self._spikes = {name: np.zeros(size, np.int64) for name, size in program.sizes.items()}
        self._counts = np.zeros((2, len(program.layers)), np.int64)
        self.reset()

    def reset(self) -> None:
        """Set all membranes to 0; the ledger stays."""
        self._working = EventNetwork(self._rules, self.program, self._process)

    def process(self, neurons: NDArray[np.integer[Any]]) -> dict[str, OrderedSpikes]:
        """Spikes of each layer, in their order, that follow from events of the input.

        neurons: (E,) of the input, in C order of its shape, in the order of their time. Spikes name
            the event that they follow from by its place in it.
        """
        self._check(neurons)
        parts: list[dict[str, OrderedSpikes]] = []
        for first in range(0, len(neurons), _PART):
            part = neurons[first : first + _PART].astype(np.int64)
            events = OrderedSpikes(np.arange(first, first + len(part)), part)
            sent = self._working.process(events)
            self._count(events, sent)
            parts.append(sent)
        none = OrderedSpikes(np.zeros(0, np.int64), np.zeros(0, np.int64))
        names = [layer.name for layer in self.program.layers]
        if len(parts) == 1:
            return parts[0]
        return {
            name: OrderedSpikes(
                *map(np.concatenate, zip(none, *(p[name] for p in parts), strict=True))
            )
            for name in names
        }

    @property
    def membrane(self) -> dict[str, NDArray[np.int64]]:
        """(N,) of each layer now [state units]."""
        return {name: state.membrane.copy() for name, state in self._working.states.items()}

    @property
    def remarks(self) -> tuple[str, ...]:
        """Deviations of the chip from the file, one sentence each."""
        return self.program.remarks

    @property
    def ledger(self) -> Ledger:
        """The events since the machine was made, in one row; they took no timesteps."""
        spikes = {name: counts[None] for name, counts in self._spikes.items()}
        updates, overflows = self._counts[:, None]
        none = np.zeros_like(updates)
        builder = LedgerBuilder(self.program, "total")
        builder.add(count_events(self.program, spikes, updates, overflows, none, 0), 0, 0)
        return builder.ledger()

    def _count(self, events: OrderedSpikes, sent: Mapping[str, OrderedSpikes]) -> None:
        for name, each in {self.program.input: events, **sent}.items():
            counts = self._spikes[name]
            counts += np.bincount(each.neuron, minlength=len(counts))
        for k, state in enumerate(self._working.states.values()):
            self._counts[:, k] += state.touched.sum(), state.overflows.sum()
            state.touched[:] = state.overflows[:] = 0

    def _check(self, neurons: NDArray[Any]) -> None:
        width = self.program.width
        if neurons.ndim != 1 or neurons.dtype.kind not in "iu":
            raise ObservationError(
                f"the events have shape {neurons.shape} and are {neurons.dtype}; give the neuron "
                "of each in the input, (E,) integers."
            )
        outside = neurons[(neurons < 0) | (neurons >= width)]
        if outside.size:
            raise ObservationError(
                f"an event of neuron {outside[0]}: the input has the neurons 0 to {width - 1}. Cut "
                "the recording to the network's input."
            )


@dataclass(frozen=True)
class _CompiledEvents(IntegrateAndFire):
    """IntegrateAndFire whose timesteps of events are compiled."""

    def update_together(
        self,
        network: Network,
        presynaptic: Mapping[str, Any],
        states: Mapping[str, LayerState],
    ) -> Mapping[str, StepResult]:
        """Advance all layers by one timestep, in which these spikes (B, M) of the input arrive."""
        return update_by_events(self, network, presynaptic, states, numba_events.process_queue)


class EventPipeline(InterpreterBackend):
    """Timesteps of a program that goes event by event, with compiled kernels."""

    def __init__(self, program: Program, schedule: Schedule, batch: int) -> None:
        compiled = _CompiledEvents(**vars(program.chip.arithmetic))
        program = replace(program, chip=replace(program.chip, arithmetic=compiled))
        super().__init__(program, schedule, batch)

    @staticmethod
    def obstacle(program: Program) -> str | None:
        """The reason why it cannot compute the program; None where it can."""
        arithmetic = program.chip.arithmetic
        if not isinstance(arithmetic, IntegrateAndFire) or not arithmetic.by_events:
            return f"chip {program.chip.name!r} does not go event by event."
        if edges(arithmetic.membrane) is None:
            return f"chip {program.chip.name!r} has a membrane that neither clips nor saturates."
        if find_spec("numba") is None:
            return "Numba is not installed. In the checkout of spikedeploy: pip install '.[fast]'."
        return None
