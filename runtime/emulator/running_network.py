"""A network on a chip or in float: the one place that decides."""

from collections.abc import Mapping
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.artifact.artifact import Artifact
from spikedeploy.runtime.chips.chip import Chip
from spikedeploy.runtime.chips.chip import chip as datasheet
from spikedeploy.runtime.chips.layer import Recording
from spikedeploy.runtime.compiler.compile import compile_program
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.copies import Copyable
from spikedeploy.runtime.emulator.backend import BackendMaker, BackendName
from spikedeploy.runtime.emulator.interpreter import count
from spikedeploy.runtime.emulator.ledger import Ledger, LedgerBuilder, Rows
from spikedeploy.runtime.emulator.machine import Machine
from spikedeploy.runtime.errors import ConfigError, RuleError
from spikedeploy.runtime.faults import NONE, Faults, inject
from spikedeploy.runtime.float_model import FloatGraph
from spikedeploy.runtime.graph.ports import Port, by_port

_FLOAT = "float"


class FloatMachine(Copyable):
    """The float twin with the calls of a Machine; it counts what a chip without rounding would do.

    spikes: (B, T, *N) of each spiking node in the last inference.
    """

    def __init__(self, artifact: Artifact, ledger: Rows = "each") -> None:
        self.graph = FloatGraph(artifact)
        self.spikes: dict[str, NDArray[Any]] = {}
        self._input: Mapping[str, NDArray[Any]] = {}
        self._ledger: LedgerBuilder | None = None
        self._has_numbers = False  # whether anything came in that is no spike
        self._stateless: RuleError | None = None  # why no chip has its currents and membranes
        try:
            self._program: Program | RuleError = self._counted(artifact)
        except RuleError as error:
            # a graph that no chip can hold still runs in float; it only cannot be counted
            self._program = error
        else:
            self._ledger = LedgerBuilder(self._program, ledger)

    def _counted(self, artifact: Artifact) -> Program:
        """The program without rounding; a reset that no chip has costs what another does."""
        try:
            return compile_program(artifact, datasheet("ideal"))
        except RuleError as error:
            if artifact.convention.reset in ("zero", "subtract"):
                raise
            self._stateless = error
        other = artifact.convention.with_options({"reset": "subtract"})
        return compile_program(artifact.with_convention(other), datasheet("ideal"))

    def reset(self) -> None:
        """Forget every current, membrane and spike; the ledger stays."""
        self.graph.reset()

    def infer(self, spikes: NDArray[Any] | Mapping[str, NDArray[Any]]) -> NDArray[np.float64]:
        """Output (B, T, act) of the spikes (B, T, M); states as the convention says.

        spikes: of several Input nodes one raster (B, T, *shape) for each, by name; any numbers,
            but only spikes are counted. Several outputs come side by side.
        """
        self._input = rows = by_port(self.graph.inputs, spikes)
        trace = self.graph.run(rows)
        names = [port.name for port in self.graph.outputs]
        outputs = [trace.pop(name) for name in (names if len(names) > 1 else ["output"])]
        self.spikes = {name: np.asarray(rows) for name, rows in trace.items()}
        if self._ledger is not None and self._ledger.keeps:
            self._count(self._ledger, rows)
        flat = [each.reshape(*each.shape[:2], -1).astype(np.float64) for each in outputs]
        return np.concatenate(flat, axis=2)

    @property
    def ledger(self) -> Ledger:
        """The events since the machine was made; every neuron-timestep is an update."""
        if self._ledger is None or self._has_numbers:
            why = "the input were no spikes, 0 or 1." if self._has_numbers else self._program
            raise RuleError(f"events cannot be counted: {why}")
        return self._ledger.ledger()

    @property
    def program(self) -> Program:
        """The program without rounding whose events are counted."""
        if isinstance(self._program, RuleError):
            raise self._program
        return self._program

    @property
    def outputs(self) -> tuple[Port, ...]:
        """The Output nodes side by side in the output."""
        return self.graph.outputs

    @property
    def remarks(self) -> tuple[str, ...]:
        """Deviations from the file: none."""
        return ()

    @property
    def recordings(self) -> Mapping[str, Recording]:
        """Recordings of the program without rounding, which reruns the last raster from zero."""
        if self._stateless is not None:
            raise self._stateless
        raster = self.program.joined(self._input)
        machine = Machine(self.program, len(raster), ledger="none", trace=True)
        machine.infer(raster)
        return machine.recordings

    def _count(self, ledger: LedgerBuilder, rows: Mapping[str, NDArray[Any]]) -> None:
        if any(each.dtype.kind not in "bu" or each.max() > 1 for each in rows.values()):
            self._has_numbers |= not all(np.isin(each, (0, 1)).all() for each in rows.values())
        if self._has_numbers:
            return
        spikes: dict[str, NDArray[Any]] = {
            name: each.reshape(*each.shape[:2], -1) for name, each in self.spikes.items()
        }
        raster = self.program.joined(rows).astype(np.uint8)
        timesteps = raster.shape[1]
        counts = count(self.program, {self.program.input: raster, **spikes})
        ledger.add(counts, timesteps, self.program.steps(timesteps))


RunningNetwork: TypeAlias = FloatMachine | Machine


def chip_or_float(name: str) -> Chip | None:
    """The chip of that name; None for "float", the float twin."""
    return None if name == _FLOAT else datasheet(name)


def run_network(
    artifact: Artifact,
    chip: Chip | None,
    ledger: Rows = "each",
    trace: bool = False,
    backend: BackendName | BackendMaker | None = None,
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
        return Machine(program, None, ledger, trace, backend or "numpy")
    if backend is not None:
        raise ConfigError(
            f"--backend {backend} is for programs of a chip; float runs in NumPy. Leave it out, or "
            "choose a chip."
        )
    return FloatMachine(artifact, ledger)
