"""Backends, which compute a program: their interface, and the choice among them."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import Any, Literal, Protocol, TypeAlias, get_args

import numpy as np
from numpy.typing import DTypeLike, NDArray

from spikedeploy.runtime import choices
from spikedeploy.runtime.chips.layer import Recording
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.emulator.ledger import LedgerBuilder
from spikedeploy.runtime.errors import ConfigError, ObservationError

# "numpy" needs nothing else; "numba" compiles, several times faster; "auto" compiles where it can;
# "interpreter" is their specification. An arithmetic without kernels is interpreted by "numpy" and
# "auto" too.
BackendName = choices.BackendName
# which of them a name stands for, the first that can run the program
_PREFERENCES: Mapping[str, tuple[str, ...]] = {
    "numpy": ("numpy", "interpreter"),
    "numba": ("numba",),
    "auto": ("numba", "numpy", "interpreter"),
    "interpreter": ("interpreter",),
}
_INTERPRETER = "spikedeploy.runtime.emulator.interpreter:InterpreterBackend"

# "window": all timesteps of a layer at once; "row": one timestep of all layers after another, which
# closes loops; "step": one timestep of the chip, with the delays of the chip
RunMode = Literal["window", "row", "step"]

# what a backend needs to go on, arrays by name; only a backend of the same class reads them
SavedState = dict[str, NDArray[Any]]


def concatenate_recordings(
    parts: Sequence[Mapping[str, Recording]], axis: int
) -> dict[str, Recording]:
    """Recordings of the same layers as one: axis 0 is the batch, 1 the timesteps."""
    return {
        name: Recording(
            *(
                np.concatenate([getattr(part[name], quantity) for part in parts], axis)
                for quantity in ("current", "membrane", "spikes")
            )
        )
        for name in parts[0]
    }


@dataclass(frozen=True)
class Schedule:
    """The windows that a backend is prepared for.

    mode: which of its loops over layers and timesteps is the outer one.
    timesteps: T of a window.
    steps: chip timesteps that a window stands for.
    delays: rows by which the synapses of each layer deliver late.
    kept: whether states continue from window to window.
    trace: whether `recordings` will be asked for.
    counting: whether `report` will be.
    """

    mode: RunMode
    timesteps: int
    steps: int
    delays: tuple[tuple[int, ...], ...]
    kept: bool
    trace: bool
    counting: bool


class Backend(Protocol):
    """A program in memory, ready to run windows of T timesteps for a batch of B."""

    schedule: Schedule

    def __init__(self, program: Program, schedule: Schedule, batch: int) -> None: ...

    @staticmethod
    def obstacle(program: Program) -> str | None:
        """The reason why it cannot compute the program, and what to do; None where it can."""

    def reset(self) -> None:
        """Forget every current, membrane and spike."""

    def run(self, rows: NDArray[Any], step: int | None = None) -> NDArray[Any]:
        """Spikes (T, B, N) as they reach the readout, from those of the input (T, B, M).

        step: chip timestep of a single row; layers that start later only wait.
        """

    def report(self, ledger: LedgerBuilder) -> None:
        """Enter the last window in the ledger."""

    def recordings(self) -> Mapping[str, Recording]:
        """The recording of each layer in the last window."""

    def membranes(self, layer: str) -> NDArray[Any]:
        """Membranes (T, B, N) of a layer after each timestep of the last window [state units].

        Where T is above 1 the schedule must have a trace, for spikes too.
        """

    def spikes(self, layer: str) -> NDArray[Any]:
        """Spikes (T, B, N) of a layer in the last window."""

    def states(self) -> dict[str, tuple[NDArray[Any], NDArray[Any]]]:
        """Current and membrane (B, N) of each layer; the current (B, K, N) where it has K."""

    def saved(self) -> SavedState:
        """Copies of all states, and of the spikes that have not arrived yet."""

    def restore(self, saved: SavedState) -> None:
        """Continue from there; T may be another where layers run row by row."""


# makes a backend that has no name here, such as hardware in simulation, as a class of backends does
BackendMaker: TypeAlias = Callable[[Program, Schedule, int], Backend]


def backend_class(program: Program, name: str) -> type[Backend]:
    """The backend of that name that computes the program; loads no other."""
    if name not in get_args(BackendName):
        choices = ", ".join(map(repr, get_args(BackendName)))
        raise ConfigError(f"backend {name!r} is unknown. Choose one of {choices}.")
    arithmetic = program.chip.arithmetic
    if program.upsets is not None:
        if arithmetic.all_at_once:
            raise ConfigError(
                "queue is 'on': lost and spurious spikes and flipped bits of states are emulated "
                "layer by layer, and not in the chip's queue. Choose queue=off, or other faults."
            )
        if name == "numba":
            raise ConfigError(
                "backend 'numba': lost and spurious spikes and flipped bits of states are drawn by "
                "the interpreter alone. Choose backend='numpy', which then interprets."
            )
        name = "interpreter"
    able = {**arithmetic.backends, "interpreter": _INTERPRETER}
    obstacle: str | None = (
        f"chip {program.chip.name!r} computes with {type(arithmetic).__name__}, which is "
        f"supported by {' and '.join(able)} alone."
    )
    for each in _PREFERENCES[name]:
        if each in able:
            module, _, attribute = able[each].partition(":")
            found: type[Backend] = getattr(import_module(module), attribute)
            if (obstacle := found.obstacle(program)) is None:
                return found
    raise ConfigError(f"backend {name!r}: {obstacle} Or choose backend='numpy'.")


def unsupported_synapses(program: Program) -> str | None:
    """The reason why no kernel computes the program's synapses; None where kernels do."""
    for layer in program.layers:
        if layer.graded:
            return (
                f"layer {layer.name!r}: its sigma-delta neurons send graded spikes, which only "
                "the interpreter supports."
            )
        if any(synapses.shift for synapses in layer.synapses):
            return (
                f"layer {layer.name!r}: its weights have a negative exponent, by which "
                f"{program.chip.name} rounds sums, which only the interpreter supports."
            )
    return None


def check_counts(rows: NDArray[Any], most: int) -> None:
    """Refuse more spikes than an input takes at once."""
    # what rows.max() does, without its detour through Python
    if rows.dtype.kind == "u" and int(np.maximum.reduce(rows, axis=None)) > most:
        raise not_spikes(rows, most)


def not_spikes(values: NDArray[Any], most: int = 1) -> ObservationError:
    """The error for values that are no spikes, or more of them than an input takes at once."""
    range_ = "0 or 1" if most == 1 else f"0 to {most}"
    return ObservationError(
        f"the raster holds {values.dtype} values; it must hold at least one timestep, and {range_} "
        "in bool or unsigned integers. Convert it with spikes.astype(bool), or clip the counts."
    )


# [bytes] of a cache line; large arrays of NumPy begin 16 bytes after one, which costs a fifth
LINE = 64


def aligned_zeros(shape: tuple[int, ...], dtype: DTypeLike) -> NDArray[Any]:
    """Zeros that begin with a cache line."""
    size = math.prod(shape) * np.dtype(dtype).itemsize
    raw = np.zeros(size + LINE, np.uint8)
    start = -raw.ctypes.data % LINE
    return raw[start : start + size].view(dtype).reshape(shape)


def aligned_copy(values: NDArray[Any], dtype: DTypeLike) -> NDArray[Any]:
    """A copy of the values that begins with a cache line."""
    copy = aligned_zeros(values.shape, dtype)
    np.copyto(copy, values, casting="unsafe")
    return copy
