"""A network on a chip or in float: the one place that decides, and machines for any batch."""

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.artifact.artifact import Artifact
from spikedeploy.runtime.chips.chip import Chip
from spikedeploy.runtime.chips.chip import chip as datasheet
from spikedeploy.runtime.chips.damage import Damage, summed
from spikedeploy.runtime.compiler.compile import compile_program
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.emulator.backend import BackendName, Recording, joined
from spikedeploy.runtime.emulator.float_machine import FloatMachine
from spikedeploy.runtime.emulator.ledger import Ledger, LedgerBuilder, Rows
from spikedeploy.runtime.emulator.machine import Machine, SerialCalls, snapshot
from spikedeploy.runtime.errors import ConfigError, ObservationError
from spikedeploy.runtime.faults import NONE, Faults, inject
from spikedeploy.runtime.graph.ports import Port, check_unmasked

_FLOAT = "float"
# inferences that are computed at once: enough to fill matrix products, few enough for the cache
CHUNK = 64


def chip_called(name: str) -> Chip | None:
    """The chip of that name; None for "float", the float twin."""
    return None if name == _FLOAT else datasheet(name)


class RunningNetwork(Protocol):
    """A network on a chip or in float: FloatMachine or MachinePool."""

    def reset(self) -> None:
        """Forget every current, membrane and spike; the ledger stays."""

    def infer(self, spikes: NDArray[Any] | Mapping[str, NDArray[Any]]) -> NDArray[np.float64]:
        """Output (B, T, act) of the spikes (B, T, M), or of a raster for each Input node."""

    @property
    def program(self) -> Program:
        """What runs; of the float twin the program without rounding. RuleError if none can."""

    @property
    def ledger(self) -> Ledger:
        """What happened since it was made; RuleError where that cannot be counted."""

    @property
    def spikes(self) -> Mapping[str, NDArray[Any]]:
        """(B, T, N) of each spiking node in the last inference, where it was traced."""

    @property
    def recordings(self) -> Mapping[str, Recording]:
        """The same with currents and membranes."""

    @property
    def outputs(self) -> tuple[Port, ...]:
        """The Output nodes side by side in the output."""

    @property
    def remarks(self) -> tuple[str, ...]:
        """Deviations of the chip from the file, one sentence each."""


class MachinePool:
    """A Machine for each batch size that comes along; copied and called as a Machine is.

    program: what they run.
    ledger: rows to keep, as in LedgerBuilder.
    backend: what computes, as in Machine.
    trace: whether `infer` leaves a Recording of each layer in `recordings`.
    """

    def __init__(
        self,
        program: Program,
        ledger: Rows = "each",
        backend: BackendName = "numpy",
        trace: bool = False,
    ) -> None:
        self.program = program
        self.recordings: dict[str, Recording] = {}
        self._backend: BackendName = backend
        self._trace = trace
        self._ledger = LedgerBuilder(program, ledger)
        self._machines: dict[int, Machine] = {}
        self._calls = SerialCalls()

    def __getstate__(self) -> dict[str, Any]:
        """Everything between two calls, so that a copy made during one is whole."""
        with self._calls.lock:
            machines = {size: each.without_ledger() for size, each in self._machines.items()}
            ledger = snapshot(self._ledger, self.program)
            return {**self.__dict__, "_machines": machines, "_ledger": ledger}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state, _machines={})
        for size, saved in state["_machines"].items():
            machine = Machine.__new__(Machine)
            machine.__setstate__({**saved, "_ledger": self._ledger})
            self._machines[size] = machine

    def reset(self) -> None:
        """Forget every current, membrane and spike; the ledger stays."""
        with self._calls.lock:
            for machine in self._machines.values():
                machine.reset()

    def infer(self, spikes: NDArray[Any] | Mapping[str, NDArray[Any]]) -> NDArray[np.float64]:
        """Output (B, T, act) of the spikes (B, T, M); states as the convention says.

        States that are kept belong to a batch size: do not change it without `reset`.

        spikes: or a raster (B, T, *shape) of each Input node, by name.
        """
        raster = spikes if isinstance(spikes, np.ndarray) else self._joined(spikes)
        batch = len(raster)
        with self._calls.lock:
            kept = self.program.convention.state == "kept"
            if batch <= CHUNK or kept or self.program.upsets is not None:
                machine = self._machine(batch)
                output = machine.infer(raster)
                self.recordings = machine.recordings
                return output
            chunks = [raster[at : at + CHUNK] for at in range(0, batch, CHUNK)]
            outputs, recorded = [], []
            for chunk in chunks:
                machine = self._machine(len(chunk))
                outputs.append(machine.infer(chunk))
                recorded.append(machine.recordings)
            self.recordings = joined(recorded, axis=0)
            return np.concatenate(outputs)

    def seed(self, seeds: Sequence[int]) -> None:
        """Start the chance of upsets anew for the episodes of B robots, if the chip has any."""
        with self._calls.lock:
            if self.program.upsets is not None:
                self._machine(len(seeds)).seed(seeds)

    @property
    def damage(self) -> tuple[Damage, ...]:
        """What faults of the chip have hit, those over time since the pool was made."""
        with self._calls.lock:
            each = [machine.damage for machine in self._machines.values()]
        return (*self.program.damage, *summed([found for found in each if found]))

    @property
    def ledger(self) -> Ledger:
        """What happened since the pool was made."""
        with self._calls.lock:
            return self._ledger.ledger()

    @property
    def spikes(self) -> dict[str, NDArray[Any]]:
        """(B, T, N) of each spiking layer in the last inference, where it was traced."""
        seen, layers = self.recordings, self.program.spiking
        return {layer.name: seen[layer.name].spikes for layer in layers if layer.name in seen}

    @property
    def outputs(self) -> tuple[Port, ...]:
        """The Output nodes side by side in the output."""
        return self.program.outputs

    @property
    def remarks(self) -> tuple[str, ...]:
        """Deviations of the chip from the file, one sentence each."""
        return self.program.remarks

    def _machine(self, batch: int) -> Machine:
        if batch not in self._machines:
            self._machines[batch] = Machine(
                self.program, batch, self._ledger, self._trace, self._backend
            )
        return self._machines[batch]

    def _joined(self, spikes: Mapping[str, NDArray[Any]]) -> NDArray[Any]:
        for name, rows in spikes.items():
            check_unmasked(rows)
            if rows.dtype.kind not in "bu":
                raise ObservationError(
                    f"the raster of node {name!r} holds {_held(rows)}; a chip takes spikes, "
                    "0 or 1. Encode them, or play them into --chip float."
                )
        return self.program.joined(spikes)


def _held(rows: NDArray[Any]) -> str:
    """What a raster holds instead of spikes: its range, or its type where all are 0 or 1."""
    if rows.dtype.kind == "f" and rows.size and not np.isin(rows, (0, 1)).all():
        return f"numbers from {rows.min():g} to {rows.max():g}"
    return f"{rows.dtype} values"


def running(
    artifact: Artifact,
    chip: Chip | None,
    ledger: Rows = "each",
    trace: bool = False,
    backend: BackendName | None = None,
    faults: Faults = NONE,
    **options: Any,  # noqa: ANN401
) -> RunningNetwork:
    """The network of an artifact, ready to run.

    chip: what it runs on; None is the float twin, in float64.
    ledger: rows to keep, as in LedgerBuilder.
    trace: whether spikes and recordings are kept; the float twin keeps spikes always.
    backend: of a chip, as in Machine; None is Machine's own choice.
    faults: of the chip; the float twin has none.
    options: for compile_program.
    """
    if chip is not None:
        program = inject(compile_program(artifact, chip, **options), faults)
        return MachinePool(program, ledger, backend or "numpy", trace)
    if backend is not None:
        raise ConfigError(
            f"--backend {backend} is for programs of a chip; float runs in NumPy. Leave it out, or "
            "choose a chip."
        )
    return FloatMachine(artifact, ledger)
