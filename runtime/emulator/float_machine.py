"""The float twin with the manners of a Machine: the same calls, and a ledger."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.artifact.artifact import Artifact
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.compiler.compile import compile_program
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.emulator.ledger import Ledger, count
from spikedeploy.runtime.emulator.ledger_builder import LedgerBuilder, Rows
from spikedeploy.runtime.errors import RuleError
from spikedeploy.runtime.float_model.graph import FloatGraph
from spikedeploy.runtime.graph.ports import Port, by_port


class FloatMachine:
    """A FloatGraph that counts what a chip without rounding would do.

    spikes: (B, T, N) of each spiking node in the last inference.
    """

    def __init__(self, artifact: Artifact, ledger: Rows = "each") -> None:
        self.graph = FloatGraph(artifact)
        self.spikes: dict[str, NDArray[Any]] = {}
        self._recorder: LedgerBuilder | None = None
        # whether anything came in that is no spike
        self._real = False
        try:
            self._program: Program | RuleError = compile_program(artifact, chip("ideal"))
        except RuleError as error:
            # a graph that no chip can hold still runs in float; it only cannot be counted
            self._program = error
        else:
            self._recorder = LedgerBuilder(self._program, ledger)

    def reset(self) -> None:
        """Forget every current, membrane and spike; the ledger stays."""
        self.graph.reset()

    def infer(self, spikes: NDArray[Any] | Mapping[str, NDArray[Any]]) -> NDArray[np.float64]:
        """Output (B, T, act) of the spikes (B, T, M); states as the convention says.

        spikes: of several Input nodes one raster (B, T, *shape) for each, by name; any numbers,
            but only spikes are counted. Several outputs come side by side.
        """
        rows = by_port(self.graph.inputs, spikes)
        trace = self.graph.run(rows)
        outputs = [trace.pop(self._key(port)) for port in self.graph.outputs]
        self.spikes = {name: np.asarray(rows) for name, rows in trace.items()}
        if self._recorder is not None and self._recorder.keeps:
            self._count(self._recorder, rows)
        flat = [each.reshape(*each.shape[:2], -1).astype(np.float64) for each in outputs]
        return np.concatenate(flat, axis=2)

    @property
    def ledger(self) -> Ledger:
        """What happened since the machine was made; every neuron-timestep is an update."""
        if self._recorder is None or self._real:
            why = "the input were no spikes, 0 or 1." if self._real else self._program
            raise RuleError(f"events cannot be counted: {why}")
        return self._recorder.ledger()

    @property
    def program(self) -> Program:
        """The program without rounding whose events are counted."""
        if isinstance(self._program, RuleError):
            raise self._program
        return self._program

    def _key(self, port: Port) -> str:
        return "output" if len(self.graph.outputs) == 1 else port.name

    def _count(self, recorder: LedgerBuilder, rows: Mapping[str, NDArray[Any]]) -> None:
        if any(each.dtype.kind not in "bu" or each.max() > 1 for each in rows.values()):
            self._real |= not all(np.isin(each, (0, 1)).all() for each in rows.values())
        if self._real:
            return
        spikes = {name: each.reshape(*each.shape[:2], -1) for name, each in self.spikes.items()}
        raster = self.program.joined(rows).astype(np.uint8)
        timesteps = raster.shape[1]
        counts = count(self.program, {self.program.input: raster, **spikes})
        recorder.add(counts, timesteps, self.program.steps(timesteps))
