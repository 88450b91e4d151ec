"""Recorded runs of networks for Speck: sinabs in timesteps, and events in their order.

A trace is a `.json` file, with the arrays of a `.npz` file of its name beside it (docs/traces.md)
Each recorded array has a key, and is computed again under the same key.
"""

import re
import zipfile
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import zip_longest
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.chips.chip import chip as datasheet
from spikedeploy.runtime.chips.layer import Layer, Synapses, plain_layer
from spikedeploy.runtime.chips.window import Window
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.convention import Convention, Reset
from spikedeploy.runtime.emulator.interpreter import trace
from spikedeploy.runtime.errors import TraceError
from spikedeploy.runtime.families.integrate_and_fire.arithmetic import IntegrateAndFire, quantise
from spikedeploy.runtime.families.integrate_and_fire.event_queues import EventNetwork, Spikes
from spikedeploy.runtime.traces.fields import MOST_NUMBERS, Fields, Integers, Work
from spikedeploy.runtime.traces.verify import (
    Difference,
    Verdict,
    assumptions,
    nothing_to_compare,
    source_of,
    unread_fields,
)

_FORMAT = "speck-trace-1"
_CHIP = "speck2f"
# the section of a trace that a key belongs to, its quantity, and the layer
_KEY = re.compile(
    r"(?P<section>timestep|float|event_(?:single|multi)_(?:cyx|yxc))_"
    r"(?P<quantity>spikes|v|v_end|weight|bias)_(?P<layer>\d+)"
)
_INPUTS = ("raster", "events_in")
# recordings that the JSON may hold too
_REPEATED = {
    f"{quantity}_{rule}_{order}"
    for quantity in ("event", "v_end") for rule in ("single", "multi") for order in ("cyx", "yxc")
} | {"events_in"}  # fmt: skip
_LEAST = -1 << 15  # of a membrane; what sinabs takes a missing lower threshold for
_MOST_BYTES = 1 << 28  # of the arrays, unpacked
_MOST_EVENTS = 1 << 16
_MOST_EXTENT = 1 << 10
_CAPPED = (
    "rounding of weights is not compared: sinabs scales a network without a lower threshold by 1 "
    "at most"
)

# by key
Arrays: TypeAlias = dict[str, NDArray[Any]]


@dataclass(frozen=True, eq=False)
class SpeckTrace:
    """A recorded network and its input.

    layers: with windows, in the chip's integers.
    reset: of all of them.
    source: (C, Y, X) of the input.
    events: (E, 4) rows of timestep, channel, y, x, in the order of processing.
    timesteps: T.
    arrays: of the NPZ.
    floats: weights and biases before they were rounded, of each layer; None where not given.
    """

    layers: tuple[Layer, ...]
    reset: Reset
    source: tuple[int, int, int]
    events: Integers
    timesteps: int
    arrays: Arrays
    floats: tuple[Layer, ...] | None

    def program(self, **options: str) -> Program:
        """The network on the chip in timesteps or, with these options, event by event."""
        convention = Convention(1e-3, self.reset, spikes="many", source="the trace")
        chip, width = datasheet(_CHIP, **options), int(np.prod(self.source))
        return Program(
            chip, convention, "input", width, self.layers, self.layers[-1].name, readout=None
        )


def speck_verdict(fields: Fields, path: Path) -> Verdict:
    """Compare everything that a trace of Speck holds with what is computed here."""
    if fields.text("format") != _FORMAT:
        raise fields.wrong("format", "is unknown", f"Write {_FORMAT!r}, as docs/traces.md has it.")
    recorded, specs, remarks = _read(fields, _read_arrays(path.with_suffix(".npz")))
    expected = dict(_recorded_arrays(recorded))
    if not expected:
        raise nothing_to_compare(fields, ())
    found: Arrays = {}
    rows = {key: len(array) for key, array in expected.items()}
    for section in dict.fromkeys(key for key in map(_section, rows) if key):
        found |= _REPLAYS[section.partition("_")[0]](recorded, section, rows)
    differences = (_first_difference(key, array, found[key]) for key, array in expected.items())
    used = {*rows, *_INPUTS, *(key.removeprefix("float_") for key in rows)}
    named = {"the file": fields, **{f"layer{k}": spec for k, spec in enumerate(specs)}}
    layer_fields = {name for spec in specs for name in unread_fields([spec], set())}
    return Verdict(
        chip=_CHIP,
        source=source_of(fields, _CHIP),
        steps=recorded.timesteps,
        compared=sum(array.size for array in expected.values()),
        passed_over=0,
        why="",
        difference=next(filter(None, differences), None),
        unread=(
            *unread_fields([fields], _REPEATED),
            *sorted(layer_fields | recorded.arrays.keys() - used),
        ),
        remarks=(*assumptions(named, _CHIP), *remarks),
    )


def _section(key: str) -> str:
    matched = _KEY.fullmatch(key)
    return matched["section"] if matched else ""


def _recorded_arrays(recorded: SpeckTrace) -> Iterator[tuple[str, NDArray[Any]]]:
    """Keys and numbers of what was recorded; whole weights stand under the keys of the floats."""
    for key, array in recorded.arrays.items():
        matched = _KEY.fullmatch(key)
        if matched is None or int(matched["layer"]) >= len(recorded.layers):
            continue
        if matched["section"] != "float":
            yield key, array
        elif recorded.floats is not None and (whole := recorded.arrays.get(key[6:])) is not None:
            yield key, whole


def _first_difference(key: str, expected: NDArray[Any], found: NDArray[Any]) -> Difference | None:
    """The first row of events, or the first number, that differs."""
    name, k = key.rpartition("_")[::2]
    if name.startswith("event") and name.endswith("spikes"):
        return _first_event(name, f"layer {k}", expected.tolist(), found.tolist())
    if expected.shape != found.shape:
        shapes = str(expected.shape), str(found.shape)
        return Difference(None, None, None, f"shape of {key}", *shapes)
    wrong = np.argwhere(expected != found)
    if not len(wrong):
        return None
    place = wrong[0].tolist()
    values = int(expected[tuple(place)]), int(found[tuple(place)])
    if len(place) == 2:
        return Difference(place[0], f"layer {k}", place[1], name, *values)
    return Difference(None, None, None, f"{key}{place}", *values)


def _first_event(
    name: str, layer: str, expected: list[list[int]], found: list[list[int]]
) -> Difference | None:
    """The first row of an event that is another, missing, or too much."""
    pairs = zip_longest(expected, found, fillvalue="none")
    for place, (one, other) in enumerate(pairs):
        if one != other:
            return Difference(place, layer, None, name, str(one), str(other))
    return None


# what is computed


def _timesteps(recorded: SpeckTrace, section: str, rows: Mapping[str, int]) -> Arrays:
    """Spike counts and membranes (T, N) of sinabs' timesteps."""
    raster = recorded.arrays.get("raster")
    if raster is None:
        raster = np.zeros((recorded.timesteps, *recorded.source), np.int64)
        np.add.at(raster, tuple(recorded.events.T), 1)
    flat = raster.reshape(1, len(raster), -1).astype(np.uint8)
    found: Arrays = {}
    for k, each in enumerate(trace(recorded.program(), flat).values()):
        found[f"timestep_spikes_{k}"], found[f"timestep_v_{k}"] = each.spikes[0], each.membrane[0]
    return found


def _events(recorded: SpeckTrace, section: str, rows: Mapping[str, int]) -> Arrays:
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
        sent = working.work(Spikes(np.array([event]), np.array([axon])))
        for k, (layer, state) in enumerate(working.states.items()):
            shape = recorded.layers[k].synapses[0].window
            if shape is not None and sent[layer].neuron.size:
                place = np.unravel_index(sent[layer].neuron, shape.target)
                spikes[k].append(np.stack([sent[layer].cause, *place], axis=1))
            if k in every and event % every[k] == 0:
                membranes[k].append(state.membrane.copy())
    found: Arrays = {}
    for k, state in enumerate(working.states.values()):
        found[f"{section}_spikes_{k}"] = np.concatenate([np.zeros((0, 4), np.int64), *spikes[k]])
        found[f"{section}_v_end_{k}"] = state.membrane
        found[f"{section}_v_{k}"] = np.array(membranes.get(k, [])).reshape(-1, len(state.membrane))
    return found


def _rounded(recorded: SpeckTrace, section: str, rows: Mapping[str, int]) -> Arrays:
    """Weights and biases that become of the float ones, by the chip's quantiser."""
    rules = datasheet(_CHIP).arithmetic
    if not isinstance(rules, IntegrateAndFire) or recorded.floats is None:
        raise TypeError(type(rules).__name__)
    found: Arrays = {}
    for k, layer in enumerate(recorded.floats):
        whole = quantise(layer, _CHIP, rules, None, limits=True)
        window = layer.synapses[0].window
        found[f"float_weight_{k}"] = whole.synapses[0].weight
        bias = whole.bias + whole.voltage_bias
        found[f"float_bias_{k}"] = bias.reshape(window.target[0] if window else 1, -1)[:, 0]
    return found


_REPLAYS: dict[str, Callable[[SpeckTrace, str, Mapping[str, int]], Arrays]] = {
    "timestep": _timesteps,
    "event": _events,
    "float": _rounded,
}


# reading


def _read(fields: Fields, arrays: Arrays) -> tuple[SpeckTrace, list[Fields], list[str]]:
    """The network and its input, the fields of each layer, and remarks."""
    source = _shape(fields, "input")
    timesteps = fields.integer("timesteps", default=1, least=1, most=_MOST_EVENTS)
    work, specs = Work(fields, timesteps), fields.groups("layers")
    layers: list[Layer] = []
    shape, pool, shapes = source, (1, 1), list[int]()
    for k, spec in enumerate(specs):
        layer, pool_after = _layer(spec, k, shape, pool, layers[-1].name if layers else "input")
        work.add(layer.size, layer.size * int(layer.synapses[0].weight[0].size))
        layers.append(layer)
        shape, pool = _window(layer).target, pool_after
        shapes.append(shape[0])
    resets = {spec.choice("reset", ("subtract", "zero")) for spec in specs}
    if len(resets) > 1:
        raise fields.wrong("reset", "differs from layer to layer", "Write the same in all.")
    reset: Reset = "subtract" if resets == {"subtract"} else "zero"
    events = _read_events(fields, arrays, source, timesteps)
    floats, remarks = _read_floats(fields, arrays, layers)
    found = SpeckTrace(tuple(layers), reset, source, events, timesteps, arrays, floats)
    states = len(events) * max(layer.size for layer in layers)
    if states > MOST_NUMBERS:
        raise fields.wrong("events_in", f"make {states} membranes", f"Record {MOST_NUMBERS}.")
    return found, specs, remarks


def _layer(
    spec: Fields, k: int, shape: tuple[int, int, int], pool: tuple[int, int], source: str
) -> tuple[Layer, tuple[int, int]]:
    """A layer behind neurons of that shape and a pool; and the pool behind it."""
    kernel = spec.array("weights", axes=4, least=-128, most=127)
    target = _shape(spec, "neurons")
    if kernel.ndim != 4:
        raise spec.wrong("weights", f"has shape {kernel.shape}", "Write [out][in][ky][kx].")
    stride, padding, behind = (
        _pair(spec, name, default)
        for name, default in (("stride", 1), ("padding", 0), ("pool_after", 1))
    )
    if min(*stride, *behind) < 1:
        raise spec.wrong("stride", "or pool_after is 0", "Write 1 or more.")
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
    spec.text("map")
    channels = spec.row("bias", size=target[0], default=0, least=-128, most=127)
    size = int(np.prod(target))
    ones = np.ones(size, np.int64)
    threshold = ones * spec.integer("threshold", default=1, least=1, most=-_LEAST - 1)
    synapses = Synapses(source, kernel.astype(np.int16), 0, window=window)
    layer = replace(
        plain_layer(f"layer{k}", [synapses], threshold),
        voltage_bias=np.repeat(channels, size // target[0]),
        floor=ones * spec.integer("min_v_mem", default=_LEAST, least=_LEAST, most=0),
    )
    return layer, behind


def _window(layer: Layer) -> Window:
    window = layer.synapses[0].window
    if window is None:
        raise TypeError("a layer of a trace has a window")
    return window


def _shape(spec: Fields, name: str) -> tuple[int, int, int]:
    found = spec.array(name, axes=1, least=1, most=_MOST_EXTENT)
    if found.shape != (3,):
        raise spec.wrong(name, f"has shape {found.shape}", "Write [channels, y, x].")
    channels, y, x = found.tolist()
    return channels, y, x


def _pair(spec: Fields, name: str, default: int) -> tuple[int, int]:
    """(y, x) of a field that may hold one number for both."""
    y, x = spec.row(name, size=2, default=default, least=0, most=_MOST_EXTENT).tolist()
    return y, x


def _read_events(
    fields: Fields, arrays: Arrays, source: tuple[int, ...], timesteps: int
) -> Integers:
    """(E, 4) of the NPZ, or of the JSON."""
    given = fields
    if "events_in" in arrays:
        given = Fields({"events_in": arrays["events_in"].tolist()}, fields.where)
    events = given.array("events_in", axes=2, least=0, most=_MOST_EVENTS)
    if events.ndim != 2 or events.shape[1] != 4 or len(events) > _MOST_EVENTS:
        remedy = f"Write rows of [timestep, channel, y, x], {_MOST_EVENTS} at most."
        raise fields.wrong("events_in", f"has shape {events.shape}", remedy)
    if (events >= [timesteps, *source]).any() or (np.diff(events[:, 0]) < 0).any():
        remedy = f"Write them in order, below {[timesteps, *source]}."
        raise fields.wrong("events_in", "has an event outside, or out of order", remedy)
    return events


def _read_floats(
    fields: Fields, arrays: Arrays, layers: list[Layer]
) -> tuple[tuple[Layer, ...] | None, list[str]]:
    """The layers before they were rounded, as far as they are there; and remarks."""
    spec = fields.group("float")
    spec.text("weights")
    numbers = spec.numbers("threshold", "min_v_mem")
    if any(f"float_weight_{k}" not in arrays for k, _ in enumerate(layers)):
        return None, []
    if "min_v_mem" not in numbers:
        return None, [_CAPPED]
    floats = []
    for k, layer in enumerate(layers):
        (synapses,), ones = layer.synapses, np.ones(layer.size)
        weight = arrays[f"float_weight_{k}"].astype(np.float64)
        if weight.size != synapses.weight.size:
            raise fields.wrong(f"float_weight_{k}", f"has shape {weight.shape}", "Record it again.")
        bias = np.ravel(arrays.get(f"float_bias_{k}", np.zeros(1))).astype(np.float64)
        made = Synapses("float", weight.reshape(synapses.weight.shape), 0, window=synapses.window)
        bias = np.repeat(bias, layer.size // bias.size)
        plain = plain_layer(layer.name, [made], ones * numbers.get("threshold", 1.0))
        floats.append(replace(plain, membrane_decay=ones, bias=bias))
    return tuple(floats), []


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
