"""A compiled program as plain numbers, `program.json`, written and read, and its recorded runs.

Each layer has its registers under the names of the chip's own tools:

    Loihi       decay_u, decay_v, vth, bias_mant, bias_exp      as NxSDK, lava and nengo-loihi
    Xylo        dash_syn, dash_mem, threshold, bias             as Rockpool's specification
    Speck       threshold, bias, floor                          as sinabs' IAF layers
    SpiNNaker2  exc_decay, alpha_decay, threshold, bias         as py-spinnaker2; floats
    Spiker      threshold, shift, v_reset; read from traces alone

A weight counts `weights[m][n] * 2**exponent`. The axon of a bias is an input like any other.

A recorded run is `expected.json`, or a file of that form from a tool or a board. It names
the file of its program, which lies beside it, and the digest of that file. Its input is a list of
events [timestep, axon], one for each spike. Where the program resets its states in each control
step, the trace is a sequence of inferences from zero states.
"""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

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
from spikedeploy.runtime.traces.fields import Fields, Integers, read_json
from spikedeploy.runtime.traces.verdict import (
    PROSE,
    QUANTITIES,
    STATE,
    TraceFile,
    check_work,
    nothing_to_compare,
    recorded_tables,
)

Registers: TypeAlias = dict[str, Any]
_WEIGHT = 1 << 31
_MOST_WIDTH = 1 << 17
_MOST_TIMESTEPS = 1 << 17
_MOST_EVENTS = 1 << 22
_DELAYS = 1 << 12
# of a program.json, what says how it is used and changes no number of a run
_USE = {
    "made_by", "format", "clock", "control_step", "placement", "host", "xylo", "remarks", "source",
    "environment", "tool", "refractory",
}  # fmt: skip


def program_record(program: Program) -> dict[str, Any]:
    """The program's integers as plain data, which `program_in` reads back as the same program."""
    chip, program = program.chip, program.dense("a record of the program")
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
                **_registers_written(layer, chip),
                "synapses": [_synapses_written(s, chip) for s in layer.synapses],
            }
            for layer in program.layers
        ],
    }


def program_in(fields: Fields, timesteps: int, inference: int = 0) -> Program:
    """The program in the fields of a `program.json`; TraceError where they do not make one.

    timesteps, inference: of a replay, as in check_work.
    """
    chip = fields.choice("chip", tuple(CHIPS))
    on = replace(datasheet(chip), delay_max=_DELAYS)
    source = fields.group("input")
    name, width = source.text("name"), source.integer("width", default=0, least=1, most=_MOST_WIDTH)
    specs = fields.groups("layers")
    sizes = {name: width}
    for spec in specs:
        sizes[spec.text("name")] = spec.integer("neurons", default=0, least=1, most=_MOST_WIDTH)
    if len(sizes) != len(specs) + 1:
        raise fields.wrong("layers", "share a name", "Give each layer a name of its own.")
    layers = tuple(_layer_read(spec, sizes, on) for spec in specs)
    output = fields.text("output")
    if output not in {layer.name for layer in layers}:
        raise fields.wrong("output", f"is {output[:40]!r}", "Name one of the layers.")
    try:
        convention = Convention(
            dt=float(fields.floats("dt")[0]),
            reset=fields.text("reset"),  # type: ignore[arg-type]  # it is checked there
            spikes=fields.text("spikes"),  # type: ignore[arg-type]
            floor=fields.text("floor"),  # type: ignore[arg-type]
            state="kept",
            source="the program",
        )
        found = Program(on, convention, name, width, layers, output, None, clock="pipelined")
    except (ConventionError, RuleError) as error:
        raise fields.wrong("layers", f"make no program ({error})", "Export it again.") from error
    check_work(fields, found, timesteps, inference)
    return found


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
        if layer.graded or layer.aliases or np.any(layer.v_reset) or layer.bias.any():
            raise ConfigError(
                f"--to program: layer {layer.name!r} has graded spikes, aliases, resets of its own "
                "or a bias that is not an axon, which the kit's scripts do not write. Export it "
                "with --to nir for the chip's own tool."
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
    source = spec.choice("source", tuple(sizes))
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
    return read_layer(spec, name, synapses, chip, spec.flag("spiking", True))


# registers


class _Register(NamedTuple):
    """A register of each neuron that holds a number of its layer as it is.

    name: in the file.
    attribute: of Layer.
    least, most: its range.
    default: where the file has none; None where it must have one.
    """

    name: str
    attribute: str
    least: int
    most: int
    default: int | None = None


def _plain_registers(chip: Chip) -> tuple[_Register, ...]:
    """The registers of chips but Loihi and SpiNNaker2; ConfigError where there is no tool."""
    rules = chip.arithmetic
    if isinstance(rules, XyloArithmetic):
        low, high = -rules.state.limit - 1, rules.state.limit
        return (
            _Register("dash_mem", "membrane_decay", 0, rules.dash_max),
            _Register("threshold", "threshold", low, high),
            _Register("bias", "voltage_bias", low, high, 0),
        )
    if isinstance(rules, IntegrateAndFire) and rules.leak in ("none", "shift"):
        low, high = -rules.membrane.limit - 1, rules.membrane.limit
        if rules.leak == "none":
            return (
                _Register("threshold", "threshold", 1, high),
                _Register("bias", "voltage_bias", low, high, 0),
            )
        return (
            _Register("threshold", "threshold", low, high),
            _Register("shift", "membrane_decay", 0, 62),
            _Register("v_reset", "v_reset", low, high, 0),
        )
    raise ConfigError(
        f"--to program: {chip.name} has no tool that a script could be written for. Choose loihi1, "
        "loihi1-nengo, loihi2, xylo-a2, speck2f or spinnaker2."
    )


# SpiNNaker2: whole weights, everything else in float32
_FLOATS = {
    "exc_decay": "current_decay",
    "alpha_decay": "membrane_decay",
    "threshold": "threshold",
    "bias": "voltage_bias",
}


def _registers_written(layer: Layer, chip: Chip) -> Registers:
    rules = chip.arithmetic
    if isinstance(rules, CubaFixedPoint):
        return _loihi_written(layer, rules)
    if isinstance(rules, CubaFloat32):
        largest = np.full(layer.size, np.finfo("f4").max)
        layer = layer if layer.spiking else replace(layer, threshold=largest)
        return {n: [float(x) for x in getattr(layer, each)] for n, each in _FLOATS.items()}
    found = {each.name: getattr(layer, each.attribute) for each in _plain_registers(chip)}
    if isinstance(rules, XyloArithmetic):
        found = {"dash_syn": layer.current_decay, **found}
    return {name: rows.tolist() for name, rows in found.items()}


def read_layer(
    spec: Fields, name: str, synapses: Sequence[Synapses], chip: Chip, spiking: bool = True
) -> Layer:
    """The layer of these synapses, whose registers are in the fields."""
    rules, size = chip.arithmetic, synapses[0].shape[1]
    layer = replace(plain_layer(name, synapses, np.zeros(size, np.int64)), spiking=spiking)
    if isinstance(rules, CubaFixedPoint):
        return _loihi_read(spec, layer, rules)
    if isinstance(rules, CubaFloat32):
        floats: dict[str, Any] = {
            e: spec.floats(n, size).astype(np.float32) for n, e in _FLOATS.items()
        }
        if not spiking:
            floats["threshold"] = np.full(size, np.inf, np.float32)
        return replace(layer, bias=np.zeros(size, np.float32), **floats)
    if isinstance(rules, XyloArithmetic):
        layer = replace(layer, current_decay=_current_dashes(spec, layer, rules))
    found: dict[str, Any] = {
        each.attribute: spec.row(
            each.name, size=size, default=each.default, least=each.least, most=each.most
        )
        for each in _plain_registers(chip)
    }
    return replace(layer, **found)


def _current_dashes(spec: Fields, layer: Layer, rules: XyloArithmetic) -> Integers:
    """(K, N) shifts of the K currents."""
    size, most = layer.size, rules.dash_max
    dashes = spec.array("dash_syn", axes=2, least=0, most=most)
    dashes = np.atleast_2d(dashes) if dashes.size in (1, size) else dashes
    if dashes.shape[1] not in (1, size) or len(dashes) > rules.currents:
        raise spec.wrong("dash_syn", f"has shape {dashes.shape}", f"Write lists of {size}.")
    rows = [*np.broadcast_to(dashes, (len(dashes), size))]
    if len(rows) == 1 and ("dash_syn_2" in spec or any(s.current for s in layer.synapses)):
        rows.append(spec.row("dash_syn_2", size=size, default=0, least=0, most=most))
    return np.stack(rows)


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


# recorded runs


def program_trace(fields: Fields, folder: Path) -> TraceFile:
    """The trace in the fields of a file in that folder."""
    beside = _program_fields(fields, folder)
    timesteps = fields.integer("timesteps", default=0, least=1, most=_MOST_TIMESTEPS)
    inference = _inference(beside.group("control_step"), fields, timesteps)
    program = program_in(beside, timesteps, inference)
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
