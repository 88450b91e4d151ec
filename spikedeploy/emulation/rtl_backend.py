"""Hardware in simulation as a backend of a Machine: RTL drives, the emulated chip runs beside it.

What leaves the RTL is what the host decodes; nothing of the emulated chip reaches an action. Beside
it the emulated chip gets the same input spikes, and counts events for the ledger. Every current,
membrane and spike of both is compared in every timestep.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from spikedeploy.exporters.verilog.simulation import Timestep
from spikedeploy.runtime.chips.layer import Recording
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.emulator.backend import Backend, SavedState, Schedule, backend_class
from spikedeploy.runtime.emulator.ledger import LedgerBuilder
from spikedeploy.runtime.errors import ConfigError

Integers = NDArray[np.int64]


class Hardware(Protocol):
    """A core that runs one program."""

    def reset(self) -> None:
        """Set every current, membrane and spike to 0."""

    def step(self, axons: Iterable[int]) -> Timestep:
        """One timestep, with its states, in which these axons of the input spike."""


@dataclass
class StateComparison:
    """A comparison of hardware with the emulated chip; it grows while both run.

    numbers: currents, membranes and spikes compared.
    differing: number of these that differ.
    first: the first difference, as a sentence; "" while there is none.
    clocks: clocks of each timestep.
    """

    numbers: int = 0
    differing: int = 0
    first: str = ""
    clocks: list[int] = field(default_factory=list)

    @property
    def timesteps(self) -> int:
        """Timesteps compared."""
        return len(self.clocks)

    def add(self, names: Sequence[str], found: Integers, wanted: Integers, clocks: int) -> None:
        """Compare a timestep; names: of each number, for a sentence."""
        wrong = np.flatnonzero(found != wanted)
        if len(wrong) and not self.first:
            at = int(wrong[0])
            self.first = (
                f"timestep {self.timesteps}: {names[at]} is {found[at]:,}, and "
                f"{wanted[at]:,} of the emulated chip"
            )
        self.numbers += len(found)
        self.differing += len(wrong)
        self.clocks.append(clocks)

    def as_json(self) -> dict[str, Any]:
        """All of it as data."""
        counts = {"timesteps": self.timesteps, "numbers": self.numbers}
        clocks = np.array(self.clocks or [0])
        spread = {
            "least": int(clocks.min()),
            "mean": float(clocks.mean()),
            "most": int(max(clocks)),
        }
        return {**counts, "differing": self.differing, "first": self.first, "clocks": spread}


class RtlBackend:
    """One network on hardware, and on the emulated chip beside it.

    program: program of both.
    schedule: windows of a single robot; states go on or are reset as it says.
    hardware: core that runs the program.
    comparison: to which every timestep is added.
    """

    def __init__(
        self,
        program: Program,
        schedule: Schedule,
        batch: int,
        hardware: Hardware,
        comparison: StateComparison,
    ) -> None:
        if batch != 1 or schedule.mode == "step":
            raise ConfigError(
                f"a core has the states of one network, and runs whole inferences: it has no way "
                f"to run {batch} networks {'timestep by timestep' if batch == 1 else 'at once'}."
            )
        self.schedule, self._program = schedule, program
        self._hardware, self._comparison = hardware, comparison
        emulated = backend_class(program, "numpy")
        self._beside: Backend = emulated(program, replace(schedule, trace=True), 1)
        ends = np.cumsum([0, *(layer.size for layer in program.layers)])
        self._parts = {
            layer.name: slice(int(first), int(first) + layer.size)
            for layer, first in zip(program.layers, ends[:-1], strict=True)
        }
        self._names = [
            f"the {quantity} of neuron {k} of layer {layer.name!r}"
            for quantity in ("current", "membrane", "spike")
            for layer in program.layers
            for k in range(layer.size)
        ]
        self._names += [
            f"output {k} of layer {layer.name!r}"
            for layer in program.layers
            if layer.name in program.output_layers
            for k in range(layer.size)
        ]
        self._lag = program.readout.lag if program.readout else 0
        self._answers: Sequence[Timestep] = ()
        self.reset()

    @staticmethod
    def obstacle(program: Program) -> str | None:
        """None: what a core cannot run was refused when it was exported."""
        return None

    def reset(self) -> None:
        """Set every current, membrane and spike of both to 0."""
        self._hardware.reset()
        self._beside.reset()
        size = self._program.layer(self._program.output).size
        self._tail = np.zeros((self._lag, 1, size), np.uint8)

    def run(self, rows: NDArray[Any], step: int | None = None) -> NDArray[Any]:
        """Spikes (T, 1, N) as they reach the readout, from those of the input (T, 1, M)."""
        self._beside.run(rows, step)
        self._answers = [self._hardware.step(np.flatnonzero(row[0])) for row in rows]
        self._compare()
        output = self._program.output
        if output not in self._program.output_layers or not self._program.layer(output).spiking:
            return np.zeros((len(rows), 1, self._program.layer(output).size), np.uint8)
        late = np.concatenate([self._tail, self.spikes(output)])
        self._tail = late[len(rows) :]
        return late[: len(rows)]

    def _compare(self) -> None:
        """Add the timesteps of the last window to the comparison."""
        recorded, program = self._beside.recordings(), self._program
        layers = [recorded[layer.name] for layer in program.layers]
        leaving = [
            recorded[layer.name].spikes if layer.spiking else recorded[layer.name].membrane
            for layer in program.layers
            if layer.name in program.output_layers
        ]
        columns = [
            *(each.current for each in layers),
            *(each.membrane for each in layers),
            *(each.spikes for each in layers),
            *leaving,
        ]
        wanted = np.concatenate([each[0].astype(np.int64) for each in columns], axis=1)
        order = [layer.name for layer in program.layers if layer.name in program.output_layers]
        for t, answer in enumerate(self._answers):
            out = [answer.values[name] for name in order]
            found = np.concatenate([answer.current, answer.membrane, answer.spikes, *out])
            self._comparison.add(self._names, found.astype(np.int64), wanted[t], answer.clocks)

    def report(self, ledger: LedgerBuilder) -> None:
        """Enter the last window in the ledger, as the emulated chip counts it."""
        self._beside.report(ledger)

    def recordings(self) -> Mapping[str, Recording]:
        """The recording of each layer in the last window, as the hardware's probe showed it."""
        return {
            name: Recording(
                *(
                    np.stack([getattr(answer, quantity)[part] for answer in self._answers])[None]
                    for quantity in ("current", "membrane", "spikes")
                )
            )
            for name, part in self._parts.items()
        }

    def membranes(self, layer: str) -> NDArray[Any]:
        """Membranes (T, 1, N) of a layer that leaves the chip [state units]."""
        return self._left(layer)

    def spikes(self, layer: str) -> NDArray[Any]:
        """Spikes (T, 1, N) of a layer that leaves the chip."""
        return self._left(layer).astype(np.uint8)

    def _left(self, layer: str) -> Integers:
        return np.stack([answer.values[layer] for answer in self._answers])[:, None]

    def states(self) -> dict[str, tuple[NDArray[Any], NDArray[Any]]]:
        """Current and membrane (1, N) of each layer after the last timestep."""
        if not self._answers:
            return self._beside.states()
        last = self._answers[-1]
        return {
            name: (last.current[None, part], last.membrane[None, part])
            for name, part in self._parts.items()
        }

    def saved(self) -> SavedState:
        """Refuse: the states of a core cannot be read back."""
        raise ConfigError("a core keeps its states: start an episode to change the timesteps.")

    def restore(self, saved: SavedState) -> None:
        """Refuse: the states of a core cannot be set."""
        raise ConfigError("a core keeps its states: start an episode to change the timesteps.")
