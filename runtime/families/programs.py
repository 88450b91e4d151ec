"""A compiled program as plain numbers, `program.json`, written and read, and its recorded runs.

Each layer has its registers under the names of the chip's own tools:

    Loihi       decay_u, decay_v, vth, bias_mant, bias_exp      as NxSDK, lava and nengo-loihi
    Xylo        dash_syn, dash_mem, threshold, bias             as Rockpool's specification
    Speck       threshold, bias, floor                          as sinabs' IAF layers
    SpiNNaker2  exc_decay, alpha_decay, threshold, bias         as py-spinnaker2; floats

    Spiker      threshold, shift, v_reset; read from traces alone

A weight counts `weights[m][n] * 2**exponent`. The axon of a bias is an input like any other.
Readers of tools' own traces (tool_traces) read registers by the same names.

A recorded run is `expected.json`, or a file of that form from a tool or a board. It names
the file of its program, which lies beside it, and the digest of that file. Its input is a list of
events [timestep, axon], one for each spike. Where the program resets its states in each control
step, the trace is a sequence of inferences from zero states.
"""

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.chips.chip import CHIPS, Chip
from spikedeploy.runtime.chips.chip import chip as datasheet
from spikedeploy.runtime.chips.layer import NEVER, Layer, Synapses, plain_layer
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.errors import ConfigError, ConventionError, RuleError, TraceError
from spikedeploy.runtime.families.cuba.arithmetic import CubaFixedPoint, CubaFloat32
from spikedeploy.runtime.families.integrate_and_fire.arithmetic import IntegrateAndFire
from spikedeploy.runtime.families.xylo import XyloArithmetic
from spikedeploy.runtime.files import suffix
from spikedeploy.runtime.traces.fields import Fields, Integers, Work, read_json
from spikedeploy.runtime.traces.verify import (
    PROSE,
    QUANTITIES,
    STATE,
    TraceFile,
    nothing_to_compare,
    recorded_tables,
)

Registers: TypeAlias = dict[str, Any]
_WEIGHT = 1 << 31
_MOST_WIDTH = 1 << 17
_DELAYS = 1 << 12


_NO_TOOL = (
    "--to program: {} has no tool that a script could be written for. Choose loihi1, "
    "loihi1-nengo, loihi2, xylo-a2, speck2f or spinnaker2."
)


@dataclass(frozen=True)
class _Form:
    """Writer and reader of a family's registers.

    written: returns the fields that stand beside those of all families.
    read: sets these fields on a layer that has only name and synapses so far.
    """

    written: Callable[[Layer, Any], Registers]
    read: Callable[[Fields, Layer, Any], Layer]


def program_record(program: Program) -> dict[str, Any]:
    """The program's integers as plain data, which `program_in` reads back as the same program."""
    chip, program = program.chip, program.dense("a record of the program")
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
        layers.append(_layer_read(spec, sizes, chip))
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
    """Refuse what a record cannot express."""
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


def _refuse(layer: Layer, registers: object) -> Registers:
    raise ConfigError(_NO_TOOL.format(layer.name))


def _form(chip: Chip) -> _Form:
    for family, form in ((CubaFixedPoint, "loihi"), (XyloArithmetic, "xylo"), (CubaFloat32, "s2")):
        if isinstance(chip.arithmetic, family):
            return _FORMS[form]
    if isinstance(chip.arithmetic, IntegrateAndFire) and chip.arithmetic.leak == "none":
        return _FORMS["iaf"]
    if isinstance(chip.arithmetic, IntegrateAndFire) and chip.arithmetic.leak == "shift":
        return _FORMS["shift"]
    raise ConfigError(_NO_TOOL.format(chip.name))


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


def _layer_read(spec: Fields, sizes: Mapping[str, int], chip: Chip) -> Layer:
    name = spec.text("name")
    synapses = [_synapses_read(each, sizes, sizes[name]) for each in spec.groups("synapses")]
    spec.integer("refractory", default=1, least=1, most=64)
    return read_layer(spec, name, synapses, chip, spec.flag("spiking") is not False)


def read_layer(
    spec: Fields, name: str, synapses: Sequence[Synapses], chip: Chip, spiking: bool = True
) -> Layer:
    """The layer of these synapses, whose registers are in the fields."""
    bare = plain_layer(name, synapses, np.zeros(synapses[0].shape[1], np.int64))
    return _form(chip).read(spec, replace(bare, spiking=spiking), chip.arithmetic)


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
    size, shift = layer.size, registers.mantissa_shift
    if not layer.spiking:
        threshold = np.full(size, NEVER)
    elif "vth_effective" in spec and "vth" not in spec:
        threshold = spec.row("vth_effective", size=size, least=0, most=STATE)
    else:
        threshold = spec.row("vth", size=size, least=0, most=registers.threshold_max) << shift
    return replace(
        layer,
        voltage_bias=_loihi_bias(spec, size),
        threshold=threshold,
        current_decay=_kept(spec, "decay_u", registers, size),
        membrane_decay=_kept(spec, "decay_v", registers, size),
    )


def _loihi_bias(spec: Fields, size: int) -> Integers:
    """(N,) [state units]."""
    if "bias_mant" not in spec:
        return spec.row("bias", size=size, default=0, least=-STATE, most=STATE)
    mantissa = spec.row("bias_mant", size=size, least=-4096, most=4095)
    exponent = spec.row("bias_exp", size=size, default=0, least=-8, most=7)
    made = np.asarray((mantissa << exponent.clip(min=0)) >> (-exponent).clip(min=0))
    if "bias" in spec and (spec.row("bias", size=size, least=-STATE, most=STATE) != made).any():
        raise spec.wrong("bias", "is not bias_mant times 2^bias_exp", "Leave the wrong one out.")
    return made


def _kept(spec: Fields, name: str, registers: CubaFixedPoint, size: int) -> Integers:
    """(N,) what a timestep leaves of 2**decay_bits."""
    current = name == "decay_u"
    offset = registers.current_decay_offset if current else registers.membrane_decay_offset
    all_of_it = registers.decay_one - offset
    # lava's model takes one more than the chip's register holds
    most = max(registers.decay_max, all_of_it * (registers.exponents == "sum"))
    # without a decay of the current it lasts one timestep
    default = all_of_it if current else None
    return all_of_it - spec.row(name, size=size, default=default, least=0, most=most)


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
    dashes = np.atleast_2d(dashes) if dashes.size in (1, size) else dashes
    if dashes.shape[1] not in (1, size) or len(dashes) > registers.currents:
        raise spec.wrong("dash_syn", f"has shape {dashes.shape}", f"Write lists of {size}.")
    rows = [*np.broadcast_to(dashes, (len(dashes), size))]
    if len(rows) == 1 and ("dash_syn_2" in spec or any(s.current for s in layer.synapses)):
        rows.append(spec.row("dash_syn_2", size=size, default=0, least=0, most=most))
    return replace(
        layer,
        current_decay=np.stack(rows),
        membrane_decay=spec.row("dash_mem", size=size, least=0, most=most),
        threshold=spec.row("threshold", size=size, least=-limit - 1, most=limit),
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


def _shift_read(spec: Fields, layer: Layer, registers: IntegrateAndFire) -> Layer:
    size, limit = layer.size, registers.membrane.limit
    return replace(
        layer,
        threshold=spec.row("threshold", size=size, least=-limit - 1, most=limit),
        membrane_decay=spec.row("shift", size=size, least=0, most=62),
        v_reset=spec.row("v_reset", size=size, default=0, least=-limit - 1, most=limit),
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
    "shift": _Form(_refuse, _shift_read),
    "s2": _Form(_float_written, _float_read),
}


_MOST_TIMESTEPS = 1 << 17
_MOST_EVENTS = 1 << 22
# of a program.json, what says how it is used and changes no number of a run
_USE = {
    "made_by", "format", "clock", "control_step", "placement", "host", "xylo", "remarks", "source",
    "environment", "tool", "refractory",
}  # fmt: skip


def program_trace(fields: Fields, folder: Path) -> TraceFile:
    """The trace in the fields of a file in that folder."""
    beside = _program_fields(fields, folder)
    timesteps = fields.integer("timesteps", default=0, least=1, most=_MOST_TIMESTEPS)
    inference = _inference(beside.group("control_step"), fields, timesteps)
    program = program_in(beside, Work(beside, timesteps, inference))
    groups, recorded = fields.group("recorded"), {}
    for layer in program.layers:
        if layer.name in groups:
            spec = groups.group(layer.name)
            recorded[layer.name] = recorded_tables(spec, (timesteps, layer.size))
            if spec.unread:
                found = f"is of no known quantity, {min(spec.unread)[:40]!r}"
                raise spec.wrong(layer.name, found, f"Record {', '.join(QUANTITIES)}.")
    raster = _raster(fields, program, timesteps).reshape(-1, inference, program.width)
    unread = tuple(sorted((fields.unread | groups.unread | beside.unread) - PROSE - _USE))
    if not any(recorded.values()):
        raise nothing_to_compare(fields, unread)
    source = fields.text("source") or program.chip.name
    return TraceFile(source, program, raster, recorded, unread)


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
