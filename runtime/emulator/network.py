"""Float or chip: the one place that decides what runs a policy's network."""

from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.artifact.artifact import Artifact
from spikedeploy.runtime.chips.chip import Chip
from spikedeploy.runtime.chips.chip import chip as datasheet
from spikedeploy.runtime.compiler.compile import compile_program
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.emulator.backend import BackendName, Recording
from spikedeploy.runtime.emulator.float_machine import FloatMachine
from spikedeploy.runtime.emulator.ledger import Ledger
from spikedeploy.runtime.emulator.ledger_builder import Rows
from spikedeploy.runtime.emulator.machine_pool import MachinePool
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.graph.ports import Port

FLOAT = "float"


def chip_called(name: str) -> Chip | None:
    """The chip of that name; None for "float", the float twin."""
    return None if name == FLOAT else datasheet(name)


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
        """What the chip does otherwise than the file says; sentences."""


def running(
    artifact: Artifact,
    chip: Chip | None,
    ledger: Rows = "each",
    trace: bool = False,
    backend: BackendName | None = None,
    **options: Any,  # noqa: ANN401
) -> RunningNetwork:
    """The network of an artifact, ready to run.

    chip: what it runs on; None is the float twin, in float64.
    ledger: rows to keep, as in LedgerBuilder.
    trace: whether spikes and recordings are kept; the float twin keeps spikes always.
    backend: of a chip, as in Machine; None is Machine's own choice.
    options: for compile_program.
    """
    if chip is not None:
        program = compile_program(artifact, chip, **options)
        return MachinePool(program, ledger, backend or "numpy", trace)
    if backend is not None:
        raise ConfigError(
            f"--backend {backend} is for programs of a chip; float runs in NumPy. Leave it out, or "
            "choose a chip."
        )
    return FloatMachine(artifact, ledger)
