"""Recorded runs of networks for Speck: sinabs in timesteps, and events in their order.

A trace is a `.json` file, with the arrays of a `.npz` file of its name beside it (docs/traces.md).
Each recorded array has a key, and is computed again under the same key.
"""

import re
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import zip_longest
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.chips.chip import chip as datasheet
from spikedeploy.runtime.chips.convolution import Window
from spikedeploy.runtime.chips.layer import Layer, Synapses, plain_layer
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.convention import Convention, Reset
from spikedeploy.runtime.emulator.interpreter import trace
from spikedeploy.runtime.errors import TraceError
from spikedeploy.runtime.families.integrate_and_fire.arithmetic import IntegrateAndFire
from spikedeploy.runtime.families.integrate_and_fire.event_queues import EventNetwork, OrderedSpikes
from spikedeploy.runtime.traces.fields import Fields, Integers
from spikedeploy.runtime.traces.verdict import (
    MOST_NUMBERS,
    TraceDifference,
    Verdict,
    assumptions,
    check_work,
    nothing_to_compare,
    source_of,
    unread_fields,
)

_FORMAT = "speck-trace-1"
_CHIP = "speck2f"
# the section of a trace that a key belongs to, its quantity, and the layer
_KEY = re.compile(
    r"(?P<section>timestep|event_(?:single|multi)_(?:cyx|yxc))_"
    r"(?P<quantity>spikes|v|v_end)_(?P<layer>\d+)"
)
# inputs, weights before and after they were rounded, and what the JSON may hold too
_REPEATED = re.compile(
    r"raster|events_in|float.*|(weight|bias)_\d+|(event|v_end)_(single|multi)_(cyx|yxc)|map"
)
_LEAST = -1 << 15  # of a membrane; what sinabs takes a missing lower threshold for
_MOST_BYTES = 1 << 28  # of the arrays, unpacked
_MOST_EVENTS = 1 << 16
_MOST_EXTENT = 1 << 10
_MOST_NEURONS = 1 << 17

Shape: TypeAlias = tuple[int, int, int]
Arrays: TypeAlias = dict[str, NDArray[Any]]  # by key


@dataclass(frozen=True, eq=False)
class _SpeckTrace:
    """A recorded network and its input.

    layers: with windows, in the chip's integers.
    reset: of all of them.
    source: (C, Y, X) of the input.
    events: (E, 4) rows of timestep, channel, y, x, in the order of processing.
    timesteps: T.
    arrays: of the NPZ.
    """

    layers: tuple[Layer, ...]
    reset: Reset
    source: Shape
    events: Integers
    timesteps: int
    arrays: Arrays

    def program(self, **options: str) -> Program:
        """The network on the chip in timesteps or, with these options, event by event."""
        convention = Convention(1e-3, self.reset, spikes="many", source="the trace")
        on, width = datasheet(_CHIP, **options), int(np.prod(self.source))
        return Program(
            on, convention, "input", width, self.layers, self.layers[-1].name, readout=None
        )


def speck_verdict(fields: Fields, path: Path) -> Verdict:
    """Compare everything that a trace of Speck holds with what is computed here."""
    fields.choice("format", (_FORMAT,))
    recorded, specs = _read(fields, _read_arrays(path.with_suffix(".npz")))
    keys = {key: matched for key in recorded.arrays if (matched := _KEY.fullmatch(key))}
    expected = {
        key: recorded.arrays[key]
        for key, matched in keys.items()
        if int(matched["layer"]) < len(recorded.layers)
    }
    if not expected:
        raise nothing_to_compare(fields, ())
    rows = {key: len(array) for key, array in expected.items()}
    found: Arrays = {}
    for section in dict.fromkeys(keys[key]["section"] for key in expected):
        replay = _replay_timesteps if section == "timestep" else _replay_events
        found |= replay(recorded, section, rows)
    differences = (_first_difference(key, array, found[key]) for key, array in expected.items())
    unread = {
        *unread_fields([fields], set()),
        *(name for spec in specs for name in unread_fields([spec], set())),
        *(recorded.arrays.keys() - expected.keys()),
    }
    named = {"the file": fields, **{f"layer{k}": spec for k, spec in enumerate(specs)}}
    return Verdict(
        chip=_CHIP,
        source=source_of(fields, _CHIP),
        steps=recorded.timesteps,
        compared=sum(array.size for array in expected.values()),
        passed_over=0,
        why="",
        difference=next(filter(None, differences), None),
        unread=tuple(sorted(name for name in unread if not _REPEATED.fullmatch(name))),
        remarks=assumptions(named, _CHIP),
    )


def _first_difference(
    key: str, expected: NDArray[Any], found: NDArray[Any]
) -> TraceDifference | None:
    """The first row of events, or the first number, that differs."""
    name, k = key.rpartition("_")[::2]
    if name.startswith("event") and name.endswith("spikes"):
        pairs = zip_longest(expected.tolist(), found.tolist(), fillvalue="none")
        for place, (one, other) in enumerate(pairs):
            if one != other:
                return TraceDifference(place, f"layer {k}", None, name, str(one), str(other))
        return None
    if expected.shape != found.shape:
        shapes = str(expected.shape), str(found.shape)
        return TraceDifference(None, None, None, f"shape of {key}", *shapes)
    wrong = np.argwhere(expected != found)
    if not len(wrong):
        return None
    place = wrong[0].tolist()
    values = int(expected[tuple(place)]), int(found[tuple(place)])
    if len(place) == 2:
        return TraceDifference(place[0], f"layer {k}", place[1], name, *values)
    return TraceDifference(None, None, None, f"{key}{place}", *values)


# what is computed


def _replay_timesteps(recorded: _SpeckTrace, section: str, rows: Mapping[str, int]) -> Arrays:
    """Spike counts and membranes (T, N) of sinabs' timesteps."""
    raster = recorded.arrays.get("raster")
    if raster is None:
        raster = np.zeros((recorded.timesteps, *recorded.source), np.int64)
        np.add.at(raster, tuple(recorded.events.T), 1)
    flat = raster.reshape(1, len(raster), -1).astype(np.uint8)
    found: Arrays = {}
    for k, each in enumerate(trace(recorded.program(), flat).values()):
        found[f"{section}_spikes_{k}"], found[f"{section}_v_{k}"] = each.spikes[0], each.membrane[0]
    return found


def _replay_events(recorded: _SpeckTrace, section: str, rows: Mapping[str, int]) -> Arrays:
    """Ordered spikes (n, 4), and membranes at the end (N,) and after input events (E, N)."""
    _, rule, order = section.split("_")
    program = recorded.program(queue="on", event_order=order, event_spikes=rule)
    rules = program.chip.arithmetic
    if not isinstance(rules, IntegrateAndFire):
        raise TypeError(type(rules).__name__)
    working = EventNetwork(rules, program)
    axons = np.ravel_multi_index(tuple(recorded.events[:, 1:].T), recorded.source)
    spikes: dict[int, list[Integers]] = {k: [] for k, _ in enumerate(recorded.layers)}
    # of some layers the membranes after every event, or after so many
    every = {
        k: -(-len(axons) // rows[key])
        for k in spikes
        if rows.get(key := f"{section}_v_{k}") and rows[key] <= len(axons)
    }
    membranes: dict[int, list[Integers]] = {k: [] for k in every}
    for event, axon in enumerate(axons):
        sent = working.process(OrderedSpikes(np.array([event]), np.array([axon])))
        for k, (layer, state) in enumerate(working.states.items()):
            if sent[layer].neuron.size:
                place = np.unravel_index(sent[layer].neuron, _window(recorded.layers[k]).target)
                spikes[k].append(np.stack([sent[layer].cause, *place], axis=1))
            if k in every and event % every[k] == 0:
                membranes[k].append(state.membrane.copy())
    found: Arrays = {}
    for k, state in enumerate(working.states.values()):
        found[f"{section}_spikes_{k}"] = np.concatenate([np.zeros((0, 4), np.int64), *spikes[k]])
        found[f"{section}_v_end_{k}"] = state.membrane
        found[f"{section}_v_{k}"] = np.array(membranes.get(k, [])).reshape(-1, len(state.membrane))
    return found


# reading


def _read(fields: Fields, arrays: Arrays) -> tuple[_SpeckTrace, list[Fields]]:
    """The network and its input, and the fields of each layer."""
    shape = source = _shape(fields, "input")
    timesteps = fields.integer("timesteps", default=1, least=1, most=_MOST_EVENTS)
    specs, layers, pool = fields.groups("layers"), list[Layer](), (1, 1)
    for spec in specs:
        layers.append(_layer(spec, layers, shape, pool))
        shape, pool = _window(layers[-1]).target, _pair(spec, "pool_after", 1)
    resets = {spec.choice("reset", ("subtract", "zero"), "subtract") for spec in specs}
    if len(resets) > 1:
        raise fields.wrong("reset", "differs from layer to layer", "Write the same in all.")
    reset: Reset = "subtract" if resets == {"subtract"} else "zero"
    events = _read_events(fields, arrays, source, timesteps)
    found = _SpeckTrace(tuple(layers), reset, source, events, timesteps, arrays)
    check_work(fields, found.program(), timesteps)
    if (states := len(events) * max(layer.size for layer in layers)) > MOST_NUMBERS:
        raise fields.wrong("events_in", f"make {states} membranes", f"Record {MOST_NUMBERS}.")
    return found, specs


def _layer(spec: Fields, before: list[Layer], shape: Shape, pool: tuple[int, int]) -> Layer:
    """A layer behind neurons of that shape and a pool."""
    kernel, target = spec.array("weights", axes=4, least=-128, most=127), _shape(spec, "neurons")
    stride, padding = _pair(spec, "stride", 1), _pair(spec, "padding", 0)
    behind = _pair(spec, "pool_after", 1)
    if kernel.ndim != 4 or min(*stride, *behind) < 1:
        found = f"have shape {kernel.shape}, stride {stride}, pool_after {behind}"
        raise spec.wrong("weights", found, "Write [out][in][ky][kx], and 1 or more.")
    window = Window(shape, target, (kernel.shape[2], kernel.shape[3]), pool, stride, padding)
    fits = tuple(
        (n + 2 * p - size) // s + 1
        for n, p, size, s in zip(window.pooled[1:], padding, window.kernel, stride, strict=True)
    )
    if target != (len(kernel), *fits) or kernel.shape[1] != shape[0]:
        found = f"is {list(target)} of a kernel {list(kernel.shape)} over {list(window.pooled)}"
        raise spec.wrong("neurons", found, f"Write {[len(kernel), *fits]}.")
    out = (target[0], target[1] // behind[0], target[2] // behind[1])
    if "out" in spec and _shape(spec, "out") != out:
        raise spec.wrong("out", "is another than neurons and pool_after say", f"Write {list(out)}.")
    channels = spec.row("bias", size=target[0], default=0, least=-128, most=127)
    size = int(np.prod(target))
    ones = np.ones(size, np.int64)
    threshold = ones * spec.integer("threshold", default=1, least=1, most=-_LEAST - 1)
    source = before[-1].name if before else "input"
    synapses = Synapses(source, kernel.astype(np.int16), 0, window=window)
    return replace(
        plain_layer(f"layer{len(before)}", [synapses], threshold),
        voltage_bias=np.repeat(channels, size // target[0]),
        floor=ones * spec.integer("min_v_mem", default=_LEAST, least=_LEAST, most=0),
    )


def _window(layer: Layer) -> Window:
    window = layer.synapses[0].window
    if window is None:
        raise TypeError("a layer of a trace has a window")
    return window


def _shape(spec: Fields, name: str) -> Shape:
    found = spec.array(name, axes=1, least=1, most=_MOST_EXTENT)
    if found.shape != (3,) or np.prod(found) > _MOST_NEURONS:
        remedy = f"Write [channels, y, x], {_MOST_NEURONS} neurons at most."
        raise spec.wrong(name, f"has shape {found.shape}", remedy)
    channels, y, x = found.tolist()
    return channels, y, x


def _pair(spec: Fields, name: str, default: int) -> tuple[int, int]:
    """(y, x) of a field that may hold one number for both."""
    y, x = spec.row(name, size=2, default=default, least=0, most=_MOST_EXTENT).tolist()
    return y, x


def _read_events(fields: Fields, arrays: Arrays, source: Shape, timesteps: int) -> Integers:
    """(E, 4) of the NPZ, or of the JSON."""
    given = arrays.get("events_in")
    events = (
        fields.array("events_in", axes=2, least=0, most=_MOST_EVENTS) if given is None else given
    )
    if events.ndim != 2 or events.shape[1] != 4 or len(events) > _MOST_EVENTS:
        remedy = f"Write rows of [timestep, channel, y, x], {_MOST_EVENTS} at most."
        raise fields.wrong("events_in", f"has shape {events.shape}", remedy)
    is_outside = (events < 0).any() or (events >= [timesteps, *source]).any()
    if is_outside or (np.diff(events[:, 0]) < 0).any():
        remedy = f"Write them in order, below {[timesteps, *source]}."
        raise fields.wrong("events_in", "has an event outside, or out of order", remedy)
    return events


def _read_arrays(path: Path) -> Arrays:
    """The arrays of an NPZ, whole numbers in int64."""
    if not path.is_file():
        raise TraceError(f"{path}: the arrays of the trace are missing. Put them beside its JSON.")
    try:
        with zipfile.ZipFile(path) as archive:
            claimed = sum(member.file_size for member in archive.infolist())
        if claimed > _MOST_BYTES:
            raise TraceError(f"{path}: it unpacks to {claimed} bytes; at most {_MOST_BYTES}.")
        with path.open("rb") as file, np.load(file, allow_pickle=False) as members:
            arrays = dict(members)
    except TraceError:
        raise
    # zipfile, zlib and numpy raise their own exceptions for a broken file
    except Exception as error:
        raise TraceError(
            f"{path}: no archive of plain arrays ({error}). Record it again."
        ) from error
    if wrong := [key for key, array in arrays.items() if array.dtype.kind not in "fiu"]:
        raise TraceError(f"{path}: {wrong[0]} holds no numbers. Record it again.")
    return {k: a if a.dtype.kind == "f" else a.astype(np.int64) for k, a in arrays.items()}
