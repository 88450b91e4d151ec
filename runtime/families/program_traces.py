"""Recorded runs of an exported program: `expected.json`, and what a tool or a board wrote like it.

Such a trace names the file of its program, which lies beside it, and the digest of that file. Its
input is a list of events [timestep, axon], one for each spike. Where the program resets its states
in each control step, the trace is one inference from zero states after another.
"""

import hashlib
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.chips.layer import Layer
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.errors import TraceError
from spikedeploy.runtime.families.program_record import program_in
from spikedeploy.runtime.traces.fields import Fields, Integers, Work, read_json
from spikedeploy.runtime.traces.verify import PROSE, QUANTITIES, TraceFile, nothing_to_compare

_MOST_TIMESTEPS = 1 << 17
_MOST_EVENTS = 1 << 22
_STATE = 1 << 40
# of a program.json, what says how it is used and changes no number of a run
_USE = {
    "made_by", "format", "clock", "control_step", "placement", "host", "remarks", "source",
    "environment", "tool", "refractory",
}  # fmt: skip


def program_trace(fields: Fields, folder: Path) -> TraceFile:
    """The trace in the fields of a file in that folder."""
    beside = _program_fields(fields, folder)
    timesteps = fields.whole("timesteps", default=0, least=1, most=_MOST_TIMESTEPS)
    inference = _inference(beside.group("control_step"), fields, timesteps)
    program = program_in(beside, Work(beside, timesteps, inference))
    groups = fields.group("recorded")
    recorded = {}
    for layer in program.layers:
        if groups.name(layer.name) is not None:
            recorded[layer.name] = _recorded(groups.group(layer.name), layer, timesteps)
    raster = _raster(fields, program, timesteps).reshape(-1, inference, program.width)
    fields.text("chip")
    unread = (fields.unread - PROSE - _USE) | groups.unread | (beside.unread - PROSE - _USE)
    if not any(recorded.values()):
        raise nothing_to_compare(fields, unread, f"{', '.join(QUANTITIES)} of a layer")
    return TraceFile(
        source=fields.text("source") or program.chip.name,
        program=program,
        raster=raster,
        recorded=recorded,
        blind_at_spikes=False,
        unread=tuple(sorted(unread)),
    )


def _inference(step: Fields, fields: Fields, timesteps: int) -> int:
    """Timesteps from zero states to the next reset, or to the end of the trace."""
    if step.text("state") != "reset":
        return timesteps
    length = step.whole("timesteps", default=0, least=1, most=_MOST_TIMESTEPS)
    if timesteps % length:
        limit = f"States are reset every {length} timesteps: record whole control steps."
        raise fields.wrong("timesteps", f"holds {timesteps}", limit)
    return length


def _program_fields(fields: Fields, folder: Path) -> Fields:
    """The program's file, which must be the one that was run."""
    name = fields.text("program")
    if Path(name).name != name or not name.endswith(".json"):
        raise fields.wrong("program", f"is {name[:40]!r}", "Name the JSON file beside this one.")
    path = folder / name
    try:
        content = path.read_bytes()
    except OSError as error:
        raise TraceError(
            f"{fields.where}: its program {name} cannot be read ({error.strerror}). Put it back "
            "beside the trace, or export the program again."
        ) from error
    digest = hashlib.sha256(content).hexdigest()
    if fields.text("program_sha256") != digest:
        raise TraceError(
            f"{fields.where}: {name} has the sha256 {digest[:16]}…, and the trace was recorded of "
            f"another, {fields.text('program_sha256')[:16]}…. Run it again, or put the file back."
        )
    return read_json(path)


def _raster(fields: Fields, program: Program, timesteps: int) -> NDArray[np.uint8]:
    """(T, M) spikes; an event that is listed n times is n of them."""
    counts = np.zeros((timesteps, program.width), np.int64)
    if fields.filled("input_events"):
        events = fields.array("input_events", axes=2, least=0, most=_MOST_EVENTS)
        if events.ndim != 2 or events.shape[1] != 2:
            found = f"has shape {events.shape}"
            raise fields.wrong("input_events", found, "Write pairs [timestep, axon].")
        if (events >= [timesteps, program.width]).any():
            limits = f"there are {timesteps} timesteps and {program.width} axons"
            raise fields.wrong("input_events", "leave the raster", f"Count from 0; {limits}.")
        np.add.at(counts, tuple(events.T), 1)
    most = program.chip.input_spikes_max
    if (repeated := int(counts.max())) > most:
        limit = f"{program.chip.name} takes {most} on an axon in a timestep."
        raise fields.wrong("input_events", f"repeat one {repeated} times", limit)
    return counts.astype(np.uint8)


def _recorded(spec: Fields, layer: Layer, timesteps: int) -> dict[str, Integers]:
    """The tables (T, N) that are there, by quantity."""
    tables = {}
    for quantity in QUANTITIES:
        if spec.name(quantity) is None:
            continue
        tables[quantity] = table = spec.array(quantity, axes=2, least=-_STATE, most=_STATE)
        if table.shape != (timesteps, layer.size):
            found, wanted = f"has shape {table.shape}", f"Write {timesteps} rows of {layer.size}."
            raise spec.wrong(quantity, found, wanted)
    if spec.unread:
        others = f"is of no known quantity, {min(spec.unread)[:40]!r}"
        raise spec.wrong(layer.name, others, f"Record {', '.join(QUANTITIES)}.")
    return tables
