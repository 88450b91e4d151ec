"""The float twin with the manners of a Machine: the same calls, and a ledger."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from runtime.artifact import Artifact
from runtime.chip import chip
from runtime.compile import compile
from runtime.errors import RuleError
from runtime.float_graph import FloatGraph
from runtime.ledger import Ledger, count
from runtime.program import Program
from runtime.recorder import Recorder, Rows


class FloatMachine:
    """A FloatGraph that counts what a chip without rounding would do.

    spikes: (B, T, N) of each spiking node in the last inference.
    """

    def __init__(self, artifact: Artifact, ledger: Rows = "each") -> None:
        self.graph = FloatGraph(artifact)
        self.spikes: dict[str, NDArray[Any]] = {}
        self._recorder: Recorder | None = None
        try:
            self._program: Program | RuleError = compile(artifact, chip("ideal"))
        except RuleError as error:
            # a graph that no chip can hold still runs in float; it only cannot be counted
            self._program = error
        else:
            self._recorder = Recorder(self._program, ledger)

    def reset(self) -> None:
        """Forget every current, membrane and spike; the ledger stays."""
        self.graph.reset()

    def infer(self, spikes: NDArray[Any]) -> NDArray[np.float64]:
        """Output (B, T, act) of the spikes (B, T, M); states as the convention says."""
        trace = self.graph.run(spikes)
        output = trace.pop("output").astype(np.float64)
        self.spikes = {name: np.asarray(rows) for name, rows in trace.items()}
        if self._recorder is not None and self._recorder.keeps:
            self._count(self._recorder, spikes)
        return output

    @property
    def ledger(self) -> Ledger:
        """What happened since the machine was made; every neuron-timestep is an update."""
        if self._recorder is None:
            raise RuleError(f"events cannot be counted: {self._program}")
        return self._recorder.ledger()

    @property
    def program(self) -> Program:
        """The program without rounding whose events are counted."""
        if isinstance(self._program, RuleError):
            raise self._program
        return self._program

    def _count(self, recorder: Recorder, spikes: NDArray[Any]) -> None:
        timesteps = spikes.shape[1]
        counts = count(self.program, {self.program.input: spikes, **self.spikes})
        recorder.add(counts, timesteps, self.program.steps(timesteps))
