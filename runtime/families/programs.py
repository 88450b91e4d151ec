"""A compiled program as plain numbers, `program.json`, written and read, and its recorded runs.

Each layer has its registers under the names of the chip's own tools:

    Loihi       decay_u, decay_v, vth, bias_mant, bias_exp      as NxSDK, lava and nengo-loihi
    Xylo        dash_syn, dash_mem, threshold, bias             as Rockpool's specification
    Speck       threshold, bias, floor                          as sinabs' IAF layers
    SpiNNaker2  exc_decay, alpha_decay, threshold, bias         as py-spinnaker2; floats

A weight counts weights[m][n] * 2**exponent. The axon of a bias is an input like any other.

A recorded run is `expected.json`, or what a tool or a board wrote like it. It names the file of its
program, which lies beside it, and the digest of that file. Its input is a list of events
[timestep, axon], one for each spike. Where the program resets its states in each control step, the
trace is one inference from zero states after another.
"""

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.chips.chip import CHIPS, Chip
from spikedeploy.runtime.chips.chip import chip as datasheet
from spikedeploy.runtime.chips.layer import NEVER, Layer, Synapses
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.errors import ConfigError, ConventionError, RuleError, TraceError
from spikedeploy.runtime.families.cuba.arithmetic import CubaFixedPoint, CubaFloat32
from spikedeploy.runtime.families.integrate_and_fire.arithmetic import IntegrateAndFire
from spikedeploy.runtime.families.xylo import XyloArithmetic
from spikedeploy.runtime.files import suffix
from spikedeploy.runtime.traces.fields import Fields, Integers, Work, read_json
from spikedeploy.runtime.traces.verify import PROSE, QUANTITIES, TraceFile, nothing_to_compare

Registers: TypeAlias = dict[str, Any]
_STATE = 1 << 40  # states beyond this are no chip's
_WEIGHT = 1 << 31
_MOST_WIDTH = 1 << 17
_DELAYS = 1 << 12


@dataclass(frozen=True)
class _Form:
    """Writer and reader of a family's registers.

    written: the fields that stand beside those of all families.
    read: the same fields onto a layer that has only name and synapses yet.
    """

    written: Callable[[Layer, Any], Registers]
    read: Callable[[Fields, Layer, Any], Layer]


def program_record(program: Program) -> dict[str, Any]:
    """The program's integers as plain data, which `program_in` reads back as the same program."""
    chip, program = program.chip, program.listed("a record of the program")
    form = _form(chip)
    _check(program)
    convention = program.convention
    return {
        "chip": chip.name,
        "dt": convention.dt,
        "reset": convention.reset,
        "spikes": convention.spikes,
        "floor": convention.floor,
        "input": {"name": program.input, "width": program.width},
        "output": program.output,
        "layers": [
            {
                "name": layer.name,
                "neurons": layer.size,
                "spiking": layer.spiking,
                "refractory": getattr(chip.arithmetic, "refractory", 1),
                **form.written(layer, chip.arithmetic),
                "synapses": [_synapses_written(s, chip) for s in layer.synapses],
            }
            for layer in program.layers
        ],
    }


def program_in(fields: Fields, work: Work) -> Program:
    """The program in the fields of a `program.json`; TraceError where they do not make one."""
    chip = _chip_of(fields)
    form = _form(chip)
    source = fields.group("input")
    name, width = source.text("name"), source.integer("width", default=0, least=1, most=_MOST_WIDTH)
    specs = fields.groups("layers")
    sizes = {name: width}
    for spec in specs:
        sizes[spec.text("name")] = spec.integer("neurons", default=0, least=1, most=_MOST_WIDTH)
    if len(sizes) != len(specs) + 1:
        raise fields.wrong("layers", "share a name", "Give each layer a name of its own.")
    layers = []
    for spec in specs:
        layers.append(_layer_read(spec, sizes, chip, form))
        synapses = sum(s.weight.size for s in layers[-1].synapses)
        axons = sum(len(s.weight) for s in layers[-1].synapses)
        work.add(layers[-1].size, synapses, 0 if form is _FORMS["loihi"] else axons)
    output = fields.text("output")
    if output not in {layer.name for layer in layers}:
        raise fields.wrong("output", f"is {output[:40]!r}", "Name one of the layers.")
    chip = replace(chip, delay_max=_DELAYS)
    try:
        convention = Convention(
            dt=float(fields.numbers("dt").get("dt", 0.0)),
            reset=fields.text("reset"),  # type: ignore[arg-type]  # it is checked there
            spikes=fields.text("spikes"),  # type: ignore[arg-type]
            floor=fields.text("floor"),  # type: ignore[arg-type]
            state="kept",
            source="the program",
        )
        found = tuple(layers)
        return Program(chip, convention, name, width, found, output, None, clock="pipelined")
    except (ConventionError, RuleError) as error:
        raise fields.wrong("layers", f"make no program ({error})", "Export it again.") from error


def _chip_of(fields: Fields) -> Chip:
    name = fields.text("chip")
    if name not in CHIPS:
        raise fields.wrong("chip", f"is {name[:40]!r}", f"It may be {', '.join(CHIPS)}.")
    return datasheet(name)


def _check(program: Program) -> None:
    """Refuse what a record cannot say."""
    name = program.chip.name
    if name not in CHIPS or datasheet(name).arithmetic != program.chip.arithmetic:
        raise ConfigError(
            f"--to program: {program.chip.name} was given with options of its arithmetic, which "
            "its tool has not. Name the chip alone."
        )
    if program.damage or program.upsets is not None:
        raise ConfigError("--to program: the chip has faults, which no tool has. Leave them out.")
    for layer in program.layers:
        if layer.graded or layer.aliases or np.any(layer.v_reset):
            what = "graded spikes" if layer.graded else "aliases or resets of its own"
            raise ConfigError(
                f"--to program: layer {layer.name!r} has {what}, which the kit's scripts do not "
                "write. Export it with --to nir for the chip's own tool."
            )
        if layer.bias.any():
            raise ConfigError(
                f"--to program: layer {layer.name!r} has a bias that is not an axon yet."
            )


def _form(chip: Chip) -> _Form:
    for family, form in ((CubaFixedPoint, "loihi"), (XyloArithmetic, "xylo"), (CubaFloat32, "s2")):
        if isinstance(chip.arithmetic, family):
            return _FORMS[form]
    if isinstance(chip.arithmetic, IntegrateAndFire) and chip.arithmetic.leak == "none":
        return _FORMS["iaf"]
    raise ConfigError(
        f"--to program: {chip.name} has no tool that a script could be written for. Choose "
        "loihi1, loihi1-nengo, loihi2, xylo-a2, speck2f or spinnaker2."
    )


def _synapses_written(synapses: Synapses, chip: Chip) -> dict[str, Any]:
    """Mantissas and the exponent that they share: the least with which they fit."""
    weights = np.asarray(synapses.weight, np.int64)
    exponent, most = 0, getattr(chip.arithmetic, "weight_max", 127)
    while not (weights & 1).any() and np.abs(weights).max(initial=0) > most:
        weights, exponent = weights >> 1, exponent + 1
    return {
        "source": synapses.source,
        "delay": synapses.delay,
        "current": synapses.current,
        "shift": synapses.shift,
        "exponent": exponent,
        "weights": weights.tolist(),
    }


def _synapses_read(spec: Fields, sizes: Mapping[str, int], size: int) -> Synapses:
    source = spec.text("source")
    if source not in sizes:
        raise spec.wrong("source", f"is {source[:40]!r}", "Name the input or a layer.")
    weights = spec.array("weights", axes=2, least=-_WEIGHT, most=_WEIGHT)
    if weights.shape != (sizes[source], size):
        remedy = f"Write {sizes[source]} rows of {size} weights."
        raise spec.wrong("weights", f"has shape {weights.shape}", remedy)
    weights = weights << spec.integer("exponent", default=0, least=0, most=15)
    return Synapses(
        source,
        weights.astype(np.int32),
        spec.integer("delay", default=0, least=0, most=_DELAYS),
        spec.integer("shift", default=0, least=0, most=15),
        spec.integer("current", default=0, least=0, most=1),
    )


def _layer_read(spec: Fields, sizes: Mapping[str, int], chip: Chip, form: _Form) -> Layer:
    name = spec.text("name")
    size, spiking = sizes[name], spec.flag("spiking")
    zero = np.zeros(size, np.int64)
    synapses = tuple(_synapses_read(each, sizes, size) for each in spec.groups("synapses"))
    spec.integer("refractory", default=1, least=1, most=64)
    bare = Layer(name, synapses, zero, zero, zero, zero, zero, 1.0, 0, spiking=spiking is not False)
    return form.read(spec, bare, chip.arithmetic)


# Loihi: u = tz(u (4096 - decay_u - offset) / 4096) + ...; thresholds are mantissas << shift


def _loihi_written(layer: Layer, registers: CubaFixedPoint) -> Registers:
    one = registers.decay_one
    mantissa, exponent = _mantissas(layer.voltage_bias, registers)
    never = np.full(layer.size, registers.threshold_max)
    vth = layer.threshold >> registers.mantissa_shift if layer.spiking else never
    return {
        "decay_u": (one - registers.current_decay_offset - layer.current_decay).tolist(),
        "decay_v": (one - registers.membrane_decay_offset - layer.membrane_decay).tolist(),
        "vth": vth.tolist(),
        "bias_mant": mantissa.tolist(),
        "bias_exp": exponent.tolist(),
    }


def _mantissas(bias: Integers, registers: CubaFixedPoint) -> tuple[Integers, Integers]:
    """Voltage biases as mantissa * 2**exponent, with the smallest exponent that holds each."""
    exponent = np.zeros(bias.shape, np.int64)
    for _ in range(registers.bias_exponent_max):
        exponent += np.abs(bias) >> exponent > registers.bias_mantissa_max
    return bias >> exponent, exponent


def _loihi_read(spec: Fields, layer: Layer, registers: CubaFixedPoint) -> Layer:
    size, one = layer.size, registers.decay_one
    mantissa = spec.row("bias_mant", size=size, default=0, least=-4096, most=4095)
    exponent = spec.row("bias_exp", size=size, default=0, least=0, most=7)
    vth = spec.row("vth", size=size, least=0, most=registers.threshold_max)
    decays = {}
    offsets = registers.current_decay_offset, registers.membrane_decay_offset
    for name, offset in zip(("decay_u", "decay_v"), offsets, strict=True):
        found = spec.row(name, size=size, least=0, most=one - offset)
        decays[name] = one - offset - found
    return replace(
        layer,
        voltage_bias=mantissa << exponent,
        threshold=vth << registers.mantissa_shift if layer.spiking else np.full(size, NEVER),
        current_decay=decays["decay_u"],
        membrane_decay=decays["decay_v"],
    )


# Xylo: decays are shifts; neurons have one or two currents


def _xylo_written(layer: Layer, registers: XyloArithmetic) -> Registers:
    return {
        "dash_syn": layer.current_decay.tolist(),
        "dash_mem": layer.membrane_decay.tolist(),
        "threshold": layer.threshold.tolist(),
        "bias": layer.voltage_bias.tolist(),
    }


def _xylo_read(spec: Fields, layer: Layer, registers: XyloArithmetic) -> Layer:
    size, limit, most = layer.size, registers.state.limit, registers.dash_max
    dashes = spec.array("dash_syn", axes=2, least=0, most=most)
    if dashes.ndim != 2 or dashes.shape[1] != size or len(dashes) > registers.currents:
        raise spec.wrong("dash_syn", f"has shape {dashes.shape}", f"Write lists of {size}.")
    if wrong := [s.source for s in layer.synapses if s.current >= len(dashes)]:
        raise spec.wrong("synapses", f"from {wrong[0]!r} feed a missing current", "Add dash_syn.")
    return replace(
        layer,
        current_decay=dashes,
        membrane_decay=spec.row("dash_mem", size=size, least=0, most=most),
        threshold=spec.row("threshold", size=size, least=1, most=limit),
        voltage_bias=spec.row("bias", size=size, default=0, least=-limit - 1, most=limit),
    )


# integrate-and-fire neurons: no decay at all


def _iaf_written(layer: Layer, registers: IntegrateAndFire) -> Registers:
    return {"threshold": layer.threshold.tolist(), "bias": layer.voltage_bias.tolist()}


def _iaf_read(spec: Fields, layer: Layer, registers: IntegrateAndFire) -> Layer:
    size, limit = layer.size, registers.membrane.limit
    return replace(
        layer,
        threshold=spec.row("threshold", size=size, least=1, most=limit),
        voltage_bias=spec.row("bias", size=size, default=0, least=-limit - 1, most=limit),
    )


# SpiNNaker2: whole weights, everything else in float32


def _float_written(layer: Layer, registers: CubaFloat32) -> Registers:
    threshold = layer.threshold if layer.spiking else np.full(layer.size, np.finfo("f4").max)
    return {
        "exc_decay": [float(x) for x in layer.current_decay],
        "alpha_decay": [float(x) for x in layer.membrane_decay],
        "threshold": [float(x) for x in threshold],
        "bias": [float(x) for x in layer.voltage_bias],
    }


def _float_read(spec: Fields, layer: Layer, registers: CubaFloat32) -> Layer:
    found = {
        name: spec.floats(name, layer.size).astype(np.float32)
        for name in ("exc_decay", "alpha_decay", "threshold", "bias")
    }
    return replace(
        layer,
        bias=np.zeros(layer.size, np.float32),
        threshold=found["threshold"] if layer.spiking else np.full(layer.size, np.inf, "f4"),
        current_decay=found["exc_decay"],
        membrane_decay=found["alpha_decay"],
        voltage_bias=found["bias"],
    )


_FORMS = {
    "loihi": _Form(_loihi_written, _loihi_read),
    "xylo": _Form(_xylo_written, _xylo_read),
    "iaf": _Form(_iaf_written, _iaf_read),
    "s2": _Form(_float_written, _float_read),
}


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
    timesteps = fields.integer("timesteps", default=0, least=1, most=_MOST_TIMESTEPS)
    inference = _inference(beside.group("control_step"), fields, timesteps)
    program = program_in(beside, Work(beside, timesteps, inference))
    groups = fields.group("recorded")
    recorded = {}
    for layer in program.layers:
        if groups.name(layer.name) is not None:
            recorded[layer.name] = _read_tables(groups.group(layer.name), layer, timesteps)
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
    length = step.integer("timesteps", default=0, least=1, most=_MOST_TIMESTEPS)
    if timesteps % length:
        limit = f"States are reset every {length} timesteps: record whole control steps."
        raise fields.wrong("timesteps", f"holds {timesteps}", limit)
    return length


def _program_fields(fields: Fields, folder: Path) -> Fields:
    """The program's file, which must be the one that was run."""
    name = fields.text("program")
    if Path(name).name != name or suffix(name) != ".json":
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
    if fields.has_content("input_events"):
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


def _read_tables(spec: Fields, layer: Layer, timesteps: int) -> dict[str, Integers]:
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
