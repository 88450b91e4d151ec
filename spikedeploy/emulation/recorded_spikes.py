"""Spikes that the author's framework recorded, against the float twin of the exported file."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from spikedeploy.emulation.rasters import Raster, read_rasters
from spikedeploy.emulation.recorded_difference import (
    Changes,
    RecordedDifference,
    difference,
    likeliest_cause,
    read_with,
)
from spikedeploy.runtime.artifact.artifact import Artifact, load
from spikedeploy.runtime.artifact.writers.writer import WRITERS
from spikedeploy.runtime.errors import ObservationError, SpikedeployError
from spikedeploy.runtime.graph.ports import Port, ports


@dataclass(frozen=True)
class RecordedAgreement:
    """A recording and the float twin.

    convention: of the file, as it was read, in one line.
    compared: outputs; `spikes` of them recorded.
    difference: the first, or None.
    cause: the options that make both equal, where some were found.
    nearest: otherwise the single option with which fewest differ, and how many.
    unread: other arrays of the file.
    """

    convention: str
    compared: int
    spikes: int
    difference: RecordedDifference | None = None
    cause: tuple[str, ...] = ()
    nearest: tuple[str, int] | None = None
    unread: tuple[str, ...] = ()

    @property
    def equal(self) -> bool:
        """Whether every output is the recorded one."""
        return self.difference is None

    def as_json(self) -> dict[str, Any]:
        """The fields as plain data."""
        found = self.difference
        return {
            "equal": self.equal,
            "convention": self.convention,
            "compared": self.compared,
            "spikes": self.spikes,
            "difference": found and {**vars(found), "neuron": list(found.neuron)},
            "cause": list(self.cause),
            "nearest": self.nearest and {"option": self.nearest[0], "differ": self.nearest[1]},
            "unread": list(self.unread),
        }

    def lines(self) -> Iterator[str]:
        """What to print."""
        yield self.convention
        if self.unread:
            yield f"not compared: {', '.join(self.unread)}"
        if self.difference is None:
            yield (
                f"your framework = our float: equal, {self.compared:,} outputs, "
                f"{self.spikes:,} spikes"
            )
            return
        yield f"your framework ≠ our float: {self.difference.describe()}"
        yield f"{self.difference.count:,} of {self.compared:,} outputs differ"
        if self.cause:
            yield f"likeliest cause: {' and '.join(self.cause)}, with which all are equal"
        else:
            near = self.nearest
            nearest = f"; {near[0]} comes nearest, {near[1]:,} differ" if near else ""
            yield (
                f"no option makes both equal{nearest}. Was the input the same, from zero states, "
                "and the file exported from this network?"
            )


def against_recorded(path: Path, recorded: Path, **options: Any) -> RecordedAgreement:  # noqa: ANN401
    """The float twin of a file against a recording of the network that it was exported from.

    recorded  .npz with `input` (T, *shape) or (B, T, *shape), and `output` likewise
    options   of artifact.load
    """
    given = {name: value for name, value in options.items() if value is not None}
    try:
        artifact = load(path, **given)
    except SpikedeployError as error:
        hint = _equal_from(path, given, recorded)
        raise type(error)(f"{error}{hint}") from error
    inputs, outputs, unread = read_recorded(recorded, artifact)
    said = artifact.convention.describe()
    spikes = int(np.count_nonzero(outputs))
    first = difference(artifact, inputs, outputs)
    if first is None:
        return RecordedAgreement(said, outputs.size, spikes, unread=unread)
    cause, nearest = likeliest_cause(path, given, artifact, inputs, outputs, first)
    return RecordedAgreement(said, outputs.size, spikes, first, cause, nearest, unread)


def _equal_from(path: Path, given: Changes, recorded: Path) -> str:
    """A sentence on the tool with whose meaning the file equals the recording, if there is one."""
    for tool in () if {"like", "written_by"} & given.keys() else WRITERS:
        artifact = read_with(path, given, {"written_by": tool})
        if artifact is not None:
            inputs, outputs, _ = read_recorded(recorded, artifact)
            if difference(artifact, inputs, outputs) is None:
                return f" With --from {tool} your framework = our float: equal."
    return ""


def read_recorded(path: Path, artifact: Artifact) -> tuple[Raster, Raster, tuple[str, ...]]:
    """Input (B, T, *shape) and output (B, T, *shape), and the names of other arrays."""
    arrays = read_rasters(path)
    if not isinstance(arrays, dict) or not {"input", "output"} <= arrays.keys():
        found = f"the arrays {', '.join(sorted(arrays))}" if isinstance(arrays, dict) else "one"
        raise ObservationError(
            f"{path} holds {found}; needed are `input` and `output`. Write it with "
            "np.savez(path, input=…, output=…)."
        )
    rows = [
        _batch(f"{path}: {name}", arrays[name], _single(name, nodes))
        for name, nodes in (("input", artifact.graph.inputs), ("output", artifact.graph.outputs))
    ]
    if rows[0].shape[:2] != rows[1].shape[:2]:
        raise ObservationError(
            f"{path}: input has (B, T) = {rows[0].shape[:2]}, output {rows[1].shape[:2]}. Record "
            "both over the same timesteps."
        )
    return rows[0], rows[1], tuple(sorted(arrays.keys() - {"input", "output"}))


def _single(name: str, nodes: Mapping[str, Any]) -> Port:
    found = ports(nodes)
    if len(found) != 1:
        names = ", ".join(port.name for port in found)
        raise ObservationError(
            f"the network has the {name}s {names}; only networks with one of each are compared "
            "with a recording. Use emulate, and compare its files."
        )
    return found[0]


def _batch(where: str, rows: Raster, port: Port) -> Raster:
    """(B, T, *shape) of what may have no axis for the batch."""
    wanted = rows[None] if rows.ndim == len(port.shape) + 1 else rows
    shape = ", ".join(map(str, port.shape))
    if wanted.ndim != len(port.shape) + 2 or wanted.shape[2:] != port.shape:
        raise ObservationError(
            f"{where} has shape {rows.shape}; node {port.name!r} needs (T, {shape}) or "
            f"(B, T, {shape}). Reshape it, or give the recording of this network."
        )
    if wanted.shape[1] == 1 and len(wanted) > 1:
        raise ObservationError(
            f"{where} has shape {rows.shape}, that is {len(wanted)} inferences of one timestep. If "
            f"its first axis is time, give (T, {shape})."
        )
    return wanted
