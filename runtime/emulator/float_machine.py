"""The float twin with the calls of a Machine, and a ledger."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.artifact.artifact import Artifact
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.compiler.compile import compile_program
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.emulator.backend import Recording
from spikedeploy.runtime.emulator.ledger import Ledger, LedgerBuilder, Rows, count
from spikedeploy.runtime.emulator.machine import Machine, SerialCalls, snapshot
from spikedeploy.runtime.errors import RuleError
from spikedeploy.runtime.float_model import FloatGraph
from spikedeploy.runtime.graph.ports import Port, by_port


class FloatMachine:
    """A FloatGraph that counts what a chip without rounding would do.

    Copied and called as a Machine is.

    spikes: (B, T, *N) of each spiking node in the last inference.
    """

    def __init__(self, artifact: Artifact, ledger: Rows = "each") -> None:
        self.graph = FloatGraph(artifact)
        self.spikes: dict[str, NDArray[Any]] = {}
        self._input: Mapping[str, NDArray[Any]] = {}
        self._ledger: LedgerBuilder | None = None
        # whether anything came in that is no spike
        self._real = False
        self._states: RuleError | None = None  # why no chip has its currents and membranes
        try:
            self._program: Program | RuleError = self._counted(artifact)
        except RuleError as error:
            # a graph that no chip can hold still runs in float; it only cannot be counted
            self._program = error
        else:
            self._ledger = LedgerBuilder(self._program, ledger)
        self._calls = SerialCalls()

    def _counted(self, artifact: Artifact) -> Program:
        """The program without rounding; a reset that no chip has costs what another does."""
        try:
            return compile_program(artifact, chip("ideal"))
        except RuleError as error:
            if artifact.convention.reset in ("zero", "subtract"):
                raise
            self._states = error
        other = artifact.convention.with_options({"reset": "subtract"})
        return compile_program(replace(artifact, convention=other), chip("ideal"))

    def __getstate__(self) -> dict[str, Any]:
        """Everything between two calls, so that a copy made during one is whole."""
        with self._calls.lock:
            program = self._program if isinstance(self._program, Program) else None
            return snapshot(self.__dict__, program)

    def reset(self) -> None:
        """Forget every current, membrane and spike; the ledger stays."""
        with self._calls.lock:
            self.graph.reset()

    def infer(self, spikes: NDArray[Any] | Mapping[str, NDArray[Any]]) -> NDArray[np.float64]:
        """Output (B, T, act) of the spikes (B, T, M); states as the convention says.

        spikes: of several Input nodes one raster (B, T, *shape) for each, by name; any numbers,
            but only spikes are counted. Several outputs come side by side.
        """
        rows = by_port(self.graph.inputs, spikes)
        with self._calls.lock:
            trace = self.graph.run(rows)
            outputs = [trace.pop(self._key(port)) for port in self.graph.outputs]
            self.spikes = {name: np.asarray(rows) for name, rows in trace.items()}
            self._input = rows
            if self._ledger is not None and self._ledger.keeps:
                self._count(self._ledger, rows)
        flat = [each.reshape(*each.shape[:2], -1).astype(np.float64) for each in outputs]
        return np.concatenate(flat, axis=2)

    @property
    def ledger(self) -> Ledger:
        """What happened since the machine was made; every neuron-timestep is an update."""
        if self._ledger is None or self._real:
            why = "the input were no spikes, 0 or 1." if self._real else self._program
            raise RuleError(f"events cannot be counted: {why}")
        with self._calls.lock:
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
        """Nothing: it does what the file says."""
        return ()

    @property
    def recordings(self) -> dict[str, Recording]:
        """Of the program without rounding, which runs the last raster once more from zero."""
        if self._states is not None:
            raise self._states
        raster = self.program.joined(self._input)
        machine = Machine(self.program, len(raster), ledger="none", trace=True)
        machine.infer(raster)
        return machine.recordings

    def _key(self, port: Port) -> str:
        return "output" if len(self.graph.outputs) == 1 else port.name

    def _count(self, ledger: LedgerBuilder, rows: Mapping[str, NDArray[Any]]) -> None:
        if any(each.dtype.kind not in "bu" or each.max() > 1 for each in rows.values()):
            self._real |= not all(np.isin(each, (0, 1)).all() for each in rows.values())
        if self._real:
            return
        spikes: dict[str, NDArray[Any]] = {
            name: each.reshape(*each.shape[:2], -1) for name, each in self.spikes.items()
        }
        raster = self.program.joined(rows).astype(np.uint8)
        timesteps = raster.shape[1]
        counts = count(self.program, {self.program.input: raster, **spikes})
        ledger.add(counts, timesteps, self.program.steps(timesteps))
