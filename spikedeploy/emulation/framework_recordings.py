"""Recordings that a framework made of a network, beside the float twin of the exported file."""

from pathlib import Path
from typing import Any

import numpy as np

from spikedeploy.emulation.other_readings import (
    CHOICES,
    LONGEST,
    Found,
    Options,
    find_cause,
    find_difference,
    left_open,
    read_with,
    typed_name,
)
from spikedeploy.emulation.rasters import Raster, read_rasters
from spikedeploy.emulation.verification import Verification
from spikedeploy.runtime.artifact.artifact import Artifact, load, read_graph_of
from spikedeploy.runtime.dialects.tools import WRITERS
from spikedeploy.runtime.errors import ObservationError, SpikedeployError
from spikedeploy.runtime.graph.ports import Port, ports


def compare_with_recording(path: Path, recorded: Path, **options: Any) -> Verification:  # noqa: ANN401
    """The float twin of a file against a recording of the network that it was exported from.

    recorded: .npz with `input` (T, *shape) or (B, T, *shape), and `output` likewise
    options: options of artifact.load
    """
    given = {name: value for name, value in options.items() if value is not None}
    try:
        artifact = load(path, **given)
    except SpikedeployError as error:
        hint = _writer_hint(path, given, recorded)
        raise type(error)(f"{error}{hint}") from error
    inputs, outputs, unread = read_recorded(recorded, artifact)
    first = find_difference(artifact, inputs, outputs)
    if first is None and not outputs.any():
        raise ObservationError(
            f"{recorded}: all {outputs.size:,} outputs are 0, and ours are: equal, which says "
            "nothing, as most readings of a network are silent alike. Record it with an input at "
            "which it puts something out."
        )
    lines = [artifact.convention.describe()]
    if unread:
        lines.append(f"not compared: {', '.join(unread)}")
    if first is None:
        found = None
        counts = f"{outputs.size:,} outputs, {np.count_nonzero(outputs):,} spikes"
        lines.append(f"your framework = our float: equal, {counts}")
    else:
        found = find_cause(path, given, artifact, inputs, outputs, first)
        neuron = ", ".join(map(str, first.neuron))
        lines += [
            f"your framework ≠ our float: inference {first.inference}, timestep {first.timestep}, "
            f"neuron {neuron}: your framework {first.expected:g}, our float {first.found:g}",
            f"{first.count:,} of {outputs.size:,} outputs differ",
            _conclusion(found, given.get("written_by")),
        ]
    nearest = found.nearest if found else None
    record = {
        "equal": first is None,
        "convention": artifact.convention.describe(),
        "compared": outputs.size,
        "spikes": int(np.count_nonzero(outputs)),
        "difference": first and {**vars(first), "neuron": list(first.neuron)},
        "cause": list(found.cause) if found else [],
        "nearest": nearest and {"option": nearest[0], "differ": nearest[1]},
        "tried": found.tried if found else 0,
        "left": found.left if found else 0,
        "unread": unread,
    }
    return Verification(recorded, first is None, tuple(lines), record)


def _conclusion(found: Found, tool: str | None) -> str:
    """A sentence on what makes both equal, or on what was tried in vain."""
    if found.cause:
        return f"likeliest cause: {' and '.join(found.cause)}, with which all are equal"
    near = (
        f"; {found.nearest[0]} comes nearest, {found.nearest[1]:,} differ" if found.nearest else ""
    )
    if found.left:
        tried = (
            f"none of {found.tried:,} other readings makes both equal{near}; {found.left:,} more "
            f"were not tried, as the search ends after {LONGEST:g} s"
        )
    else:
        steps = ", ".join(f"{dt:g}" for dt in CHOICES["dt"])
        tried = (
            f"no option, and no two of them without --like, make both equal{near}; tried were "
            f"{', '.join(map(typed_name, CHOICES))} with every choice (--dt of {steps} s)"
        )
    never = "; ".join(WRITERS[tool].always) if tool else ""
    unsaid = f" What {tool} does not write and no option says: {never}." if never else ""
    return (
        f"{tried}.{unsaid} Was the input the same, from zero states, and the file exported from "
        "this network?"
    )


def read_recorded(path: Path, artifact: Artifact) -> tuple[Raster, Raster, list[str]]:
    """Input (B, T, *shape) and output (B, T, *shape), and the names of other arrays."""
    arrays = read_rasters(path)
    if not isinstance(arrays, dict) or not {"input", "output"} <= arrays.keys():
        found = f"the arrays {', '.join(sorted(arrays))}" if isinstance(arrays, dict) else "one"
        raise ObservationError(
            f"{path} holds {found}; needed are `input` and `output`. Write it with "
            "np.savez(path, input=…, output=…)."
        )
    inputs, outputs = (
        _batch(path, name, arrays[name], ports(nodes))
        for name, nodes in (("input", artifact.graph.inputs), ("output", artifact.graph.outputs))
    )
    if inputs.shape[:2] != outputs.shape[:2]:
        raise ObservationError(
            f"{path}: input has (B, T) = {inputs.shape[:2]}, output {outputs.shape[:2]}. Record "
            "both over the same timesteps."
        )
    return inputs, outputs, sorted(arrays.keys() - {"input", "output"})


def _batch(path: Path, name: str, rows: Raster, nodes: tuple[Port, ...]) -> Raster:
    """(B, T, *shape) of the one node, for rows that may have no axis for the batch."""
    if len(nodes) != 1:
        names = ", ".join(port.name for port in nodes)
        raise ObservationError(
            f"the network has the {name}s {names}; only networks with one of each are compared "
            "with a recording. Use emulate, and compare its files."
        )
    (port,) = nodes
    wanted = rows[None] if rows.ndim == len(port.shape) + 1 else rows
    shape = ", ".join(map(str, port.shape))
    if wanted.ndim != len(port.shape) + 2 or wanted.shape[2:] != port.shape:
        raise ObservationError(
            f"{path}: {name} has shape {rows.shape}; node {port.name!r} needs (T, {shape}) or "
            f"(B, T, {shape}). Reshape it, or give the recording of this network."
        )
    if wanted.shape[1] == 1 and len(wanted) > 1:
        raise ObservationError(
            f"{path}: {name} has shape {rows.shape}, that is {len(wanted)} inferences of one "
            f"timestep. If its first axis is time, give (T, {shape})."
        )
    return wanted


def _writer_hint(path: Path, given: Options, recorded: Path) -> str:
    """A sentence on the tool with whose meaning the file equals the recording, if there is one."""
    if {"like", "written_by"} & given.keys():
        return ""
    graph = read_graph_of(path)
    for tool in WRITERS:
        for changes in left_open(tool, given):
            if (read := read_with(graph, given, changes)) is not None:
                artifact, words = read
                inputs, outputs, _ = read_recorded(recorded, artifact)
                if outputs.any() and find_difference(artifact, inputs, outputs) is None:
                    return f" With {' '.join(words)} your framework = our float: equal."
    return ""
