"""Recorded runs of Loihi, as lava, brian2_loihi, nengo-loihi and boards write them."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.chips.chip import Chip
from spikedeploy.runtime.chips.chip import chip as datasheet
from spikedeploy.runtime.chips.layer import Layer, Synapses
from spikedeploy.runtime.chips.registers import Register
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.families.cuba.arithmetic import CubaFixedPoint
from spikedeploy.runtime.families.cuba.quantise import drop_low_bits
from spikedeploy.runtime.traces.fields import Fields, Integers, Work
from spikedeploy.runtime.traces.verify import (
    PROSE,
    TraceFile,
    nothing_to_compare,
    recorded_tables,
    table_of,
)

_WEIGHTS = ("weights", "weight", "w", "weight_mant", "w_mant", "weights_mixed")
_EXPONENTS = ("weight_exp", "weight_exponent", "w_exp", "wgt_exp")
_THRESHOLDS = ("vth", "vth_mant", "v_th", "threshold")
# in units of the states, not of the mantissas
_WEIGHTS_EFFECTIVE = ("weights_effective", "weight_effective", "w_effective", "w_eff")
_REFRACTORY = ("refractory", "refract_delay", "refractory_period")
_THRESHOLDS_EFFECTIVE = ("vth_effective", "vth_eff")
EFFECTIVE = {*_WEIGHTS_EFFECTIVE, *_THRESHOLDS_EFFECTIVE}

# mantissas are shifted by so much to become states; thresholds always are
_SHIFT = 6

# how lava's model rounds; it takes a decay of one more than the chip's register holds
_LAVAS = "sum"
_BEYOND = (
    "{}: dv is 4096, which lava takes and the chip's register of 12 bits does not hold; replayed "
    "as lava computes it, the membrane keeps nothing"
)
# states beyond this are no chip's
_STATE = 1 << 40


@dataclass(frozen=True, eq=False)
class _LoihiLayer:
    """A layer, and the chip with the options that the layer asks for."""

    layer: Layer
    chip: Chip


@dataclass(frozen=True, eq=False)
class _Weights:
    """Weights as they were given.

    mantissa: (N, M).
    mixed: whether one list holds both signs, and a bit for them.
    exponent: they count 2**this times.
    """

    mantissa: Integers
    mixed: bool
    exponent: int


def _loihi_layer(
    spec: Fields, chip: Chip, place: int, fan_in: int, inputs: int, work: Work
) -> _LoihiLayer:
    """The layer at a place of a chain, as the fields describe it.

    fan_in, inputs: neurons of the layer before, and of the network's input.
    """
    arithmetic = chip.arithmetic
    if not isinstance(arithmetic, CubaFixedPoint):
        raise spec.wrong("chip", f"{chip.name} has no integers", "Name a chip that has.")
    weights = _weights(spec, arithmetic, fan_in)
    arithmetic = _with_options(spec, arithmetic, weights)
    size = len(weights.mantissa)
    synapses = _synapses(spec, chip, place, weights, arithmetic)
    if spec.name("weights_input"):
        synapses += _skip(spec, chip, place, inputs, weights, arithmetic)
    work.add(size, sum(each.weight.size for each in synapses))
    layer = Layer(
        name=f"layer{place}",
        synapses=tuple(synapses),
        bias=np.zeros(size, np.int64),
        voltage_bias=_bias(spec, size),
        threshold=_threshold(spec, arithmetic, size),
        current_decay=_decay_factor(spec, "u", arithmetic, size),
        membrane_decay=_decay_factor(spec, "v", arithmetic, size),
        scale=1.0,
        start=0,
    )
    return _LoihiLayer(layer, replace(chip, arithmetic=arithmetic))


def _synapses(
    spec: Fields, chip: Chip, place: int, weights: _Weights, arithmetic: CubaFixedPoint
) -> list[Synapses]:
    """The synapses from the layer before, a list for each sign that is apart and for each delay."""
    source = f"layer{place - 1}" if place else "input"
    if spec.name("delays") is None:
        delay = _delay(spec, chip, source)
        return [
            Synapses(source, w, delay, shift) for w, shift in _stored_lists(weights, arithmetic)
        ]
    delays = spec.array("delays", axes=2, least=0, most=chip.delay_max)
    delays = delays.T if spec.text("index").startswith("[pre]") else delays
    if delays.shape != weights.mantissa.shape:
        remedy = f"Write {weights.mantissa.shape}, as the weights have."
        raise spec.wrong("delays", f"has shape {delays.shape}", remedy)
    return [
        Synapses(source, w, int(delay), shift)
        for delay in np.unique(delays)
        for w, shift in _stored_lists(
            replace(weights, mantissa=np.where(delays == delay, weights.mantissa, 0)), arithmetic
        )
    ]


def _skip(
    spec: Fields,
    chip: Chip,
    place: int,
    inputs: int,
    weights: _Weights,
    arithmetic: CubaFixedPoint,
) -> list[Synapses]:
    """The synapses from the network's input past the layers before."""
    mantissa = _matrix(spec, "weights_input", inputs)
    if not place or len(mantissa) != len(weights.mantissa):
        raise spec.wrong(
            "weights_input",
            f"has shape {mantissa.shape}",
            "Write it for layers behind the first, with a row for each neuron.",
        )
    lists = _stored_lists(replace(weights, mantissa=mantissa), arithmetic)
    delay = _delay(spec, chip, "input")
    return [Synapses("input", w, delay, shift) for w, shift in lists]


def _delay(spec: Fields, chip: Chip, source: str) -> int:
    """Delay from spikes of a source [timesteps], that of the tool where none is given."""
    least = chip.arithmetic.input_delay(chip.delay) if source == "input" else chip.delay
    return spec.integer("delay", default=least, least=0, most=chip.delay_max)


def _weights(spec: Fields, arithmetic: CubaFixedPoint, fan_in: int) -> _Weights:
    exponent = spec.integer(*_EXPONENTS, default=0, least=-8, most=7)
    lists = [name for name in ("weights_exc", "weights_inh") if spec.name(name)]
    if lists:
        tables = [_matrix(spec, name, fan_in) for name in lists]
        if tables[0].shape != tables[-1].shape:
            raise spec.wrong(lists[1], f"has shape {tables[1].shape}", f"Match {lists[0]}.")
        return _Weights(np.asarray(sum(tables)), False, exponent)
    effective = spec.name(*_WEIGHTS_EFFECTIVE)
    if effective and spec.name(*_WEIGHTS) is None:
        return _Weights(_matrix(spec, effective, fan_in, 1 << _SHIFT) >> _SHIFT, False, 0)
    name = spec.name(*_WEIGHTS) or _WEIGHTS[0]
    mantissa = _matrix(spec, name, fan_in)
    mixed = name == "weights_mixed" or spec.flag("exc_inh_split") is False or _is_mixed(spec)
    # lava looks at the weights: a list of one sign spends no bit on it (its weightutils)
    one_sign = arithmetic.exponents == "sum" and (mantissa.min() >= 0 or mantissa.max() <= 0)
    return _Weights(mantissa, mixed and not one_sign, exponent)


def _is_mixed(spec: Fields) -> bool:
    return "mixed" in spec.text("sign_mode").lower()


def _matrix(spec: Fields, name: str, fan_in: int, unit: int = 1) -> Integers:
    """(N, M) weights, in either orientation."""
    found = spec.array(name, axes=2, least=-256 * unit, most=255 * unit)
    if found.ndim < 2:
        # one neuron with several axons, or one axon onto several neurons
        found = found.reshape((1, -1) if found.size == fan_in else (-1, 1))
    if spec.text("index").startswith("[pre]"):
        found = found.T
    if found.shape[1] != fan_in:
        remedy = f"Write a row for each neuron, with {fan_in} weights, one for each input."
        raise spec.wrong(name, f"has shape {found.shape}", remedy)
    return found


def _with_options(spec: Fields, arithmetic: CubaFixedPoint, weights: _Weights) -> CubaFixedPoint:
    refractory = spec.integer(*_REFRACTORY, default=arithmetic.refractory, least=1, most=64)
    return replace(
        arithmetic,
        sign_mode="mixed" if weights.mixed else "split",
        weight_bits=spec.integer(
            "num_weight_bits", default=arithmetic.weight_bits, least=0, most=8
        ),
        refractory=refractory,
        mantissa_shift=_mantissa_shift(spec, arithmetic, weights.exponent),
        membrane=_membrane(spec, arithmetic.membrane),
    )


def _mantissa_shift(spec: Fields, arithmetic: CubaFixedPoint, exponent: int) -> int:
    """Where nothing is rounded, a negative exponent moves the weights by fewer bits."""
    shift = _SHIFT + min(exponent, 0) * (arithmetic.exponents == "exact")
    if shift < 0:
        raise spec.wrong("weight_exp", f"is {exponent}", f"This model goes down to {-_SHIFT}.")
    return shift


def _membrane(spec: Fields, register: Register) -> Register:
    if spec.name("vmin", "vmax") is None:
        return register
    least = spec.integer("vmin", default=-register.limit, least=-_STATE, most=0)
    most = spec.integer("vmax", default=register.limit, least=0, most=_STATE)
    return replace(register, between=(least, most))


def _stored_lists(
    weights: _Weights, arithmetic: CubaFixedPoint
) -> list[tuple[NDArray[np.int16], int]]:
    """The lists of weights (M, N) that the chip stores, and the bits that each one's sum loses."""
    axons, exponent = weights.mantissa.T, weights.exponent
    if exponent >= 0 or arithmetic.exponents == "weight":
        return [(drop_low_bits(axons, arithmetic, exponent), 0)]
    if arithmetic.exponents == "exact":
        return [(drop_low_bits(axons, arithmetic), 0)]
    signs = [axons] if weights.mixed else [axons.clip(min=0), axons.clip(max=0)]
    return [(drop_low_bits(sign, arithmetic), -exponent) for sign in signs]


def _threshold(spec: Fields, arithmetic: CubaFixedPoint, size: int) -> Integers:
    """(N,) [state units]."""
    if spec.name(*_THRESHOLDS) is None and spec.name(*_THRESHOLDS_EFFECTIVE):
        return spec.row(*_THRESHOLDS_EFFECTIVE, size=size, least=0, most=_STATE)
    return spec.row(*_THRESHOLDS, size=size, least=0, most=arithmetic.threshold_max) << _SHIFT


def _bias(spec: Fields, size: int) -> Integers:
    """(N,) [state units]."""
    mantissa = spec.row("bias_mant", size=size, default=0, least=-4096, most=4095)
    exponent = spec.row("bias_exp", size=size, default=0, least=-8, most=7)
    made = np.asarray((mantissa << exponent.clip(min=0)) >> (-exponent).clip(min=0))
    if (name := spec.name("bias", "bias_effective")) is None:
        return made
    bias = spec.row(name, size=size, least=-_STATE, most=_STATE)
    if spec.name("bias_mant") and spec.name("bias_exp") and (bias != made).any():
        raise spec.wrong(name, "is not bias_mant times 2^bias_exp", "Leave the wrong one out.")
    return bias


def _decay_factor(spec: Fields, state: str, arithmetic: CubaFixedPoint, size: int) -> Integers:
    """(N,) what a timestep leaves, from the register or from what the register does."""
    offset = arithmetic.current_decay_offset if state == "u" else arithmetic.membrane_decay_offset
    names, effective = (f"d{state}", f"decay_{state}"), f"effective_decay_{state}"
    if spec.name(*names) is None and spec.name(effective):
        return arithmetic.decay_one - spec.row(
            effective, size=size, least=0, most=arithmetic.decay_one
        )
    # without a decay of the current it lasts one timestep
    default = arithmetic.decay_one - offset if state == "u" else None
    most = max(arithmetic.decay_max, arithmetic.decay_one - offset)
    most = most if arithmetic.exponents == _LAVAS else arithmetic.decay_max
    found = spec.row(*names, size=size, default=default, least=0, most=most)
    return arithmetic.decay_one - offset - found


def _beyond_register(spec: Fields, part: _LoihiLayer) -> bool:
    """True where the membrane's decay register is given as more than the chip's holds."""
    given, arithmetic = spec.name("dv", "decay_v"), part.chip.arithmetic
    lavas = isinstance(arithmetic, CubaFixedPoint) and arithmetic.exponents == _LAVAS
    return given is not None and lavas and not part.layer.membrane_decay.all()


_INPUT = ("input_spikes", "input", "inputs", "in", "spikes_in", "s_in", "in_spikes")
# and what boards' probes are called, with one of these before or after
_PROBES = ("hw", "chip", "board", "probe")


def _with_probes(*names: str) -> tuple[str, ...]:
    """The names, and those with the mark of a board's probe."""
    marked = ((f"{name}_{mark}", f"{mark}_{name}") for name in names for mark in _PROBES)
    return (*names, *(each for pair in marked for each in pair))


# quantity -> what emulators call it, and what it may be
_RECORDED = {
    "current": (_with_probes("u", "current", "I", "i"), -_STATE, _STATE),
    "membrane": (_with_probes("v", "voltage", "membrane", "v_mem"), -_STATE, _STATE),
    "spikes": (_with_probes("s", "spikes", "s_out", "output_spikes", "out_spikes", "spk"), 0, 1),
}
# given twice in the file, or by the model
_REPEATED = {
    "steps", "params", "layers", "dt", "exc_inh_split", "weights_effective_reported",
    "weights_exc", "weights_inh", "weights_mixed", "weight_effective", "weights_effective",
    "effective_decay_u", "effective_decay_v", "vth_effective", "bias_effective", "du", "decay_u",
    *EFFECTIVE, *_INPUT,
}  # fmt: skip


def loihi_trace(fields: Fields, chip: str) -> TraceFile:
    """The trace in the fields; one layer at the top, or a list of them under `layers`."""
    specs = fields.layers()
    rows = table_of(specs[0], _INPUT, 0, 1, index="input_spikes_index")
    parts, size, work = [], rows.shape[1], Work(fields, len(rows))
    for place, spec in enumerate(specs):
        part = _loihi_layer(spec, datasheet(chip), place, size, rows.shape[1], work)
        parts.append(part)
        size = parts[-1].layer.size
    _check_alike(fields, parts)
    recorded = {
        part.layer.name: recorded_tables(spec, _RECORDED, (len(rows), part.layer.size))
        for part, spec in zip(parts, specs, strict=True)
    }
    unread = set.intersection(*(spec.unread for spec in specs)) - PROSE - _REPEATED
    if not any(recorded.values()):
        raise nothing_to_compare(fields, unread, "u, v or s")
    return TraceFile(
        source=fields.text("source") or fields.text("name") or chip,
        program=_program(parts, rows.shape[1]),
        raster=rows.astype(np.uint8)[None],
        recorded=recorded,
        blind_at_spikes=chip == "loihi2",  # a board's probe shows something else there
        unread=tuple(sorted(unread)),
        remarks=tuple(
            _BEYOND.format(part.layer.name)
            for part, spec in zip(parts, specs, strict=True)
            if _beyond_register(spec, part)
        ),
    )


def _check_alike(fields: Fields, parts: list[_LoihiLayer]) -> None:
    """Refuse layers that differ in what belongs to the chip."""
    for option in ("refractory", "membrane", "mantissa_shift"):
        if len({getattr(part.chip.arithmetic, option) for part in parts}) > 1:
            raise fields.wrong(option, "differs from layer to layer", "Split the trace in two.")


def _program(parts: list[_LoihiLayer], width: int) -> Program:
    chip, layers = parts[0].chip, tuple(part.layer for part in parts)
    convention = Convention(1e-3, delay=chip.delay, source="the trace")
    output = layers[-1].name
    return Program(chip, convention, "input", width, layers, output, None, clock="pipelined")
