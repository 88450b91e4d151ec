"""Recorded runs of Loihi: layers of lava, brian2_loihi, nengo-loihi and of a board."""

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
from spikedeploy.runtime.traces.verify import TraceFile, chain_trace, layer_of, table_of

_WEIGHTS = ("weights", "weight", "w", "weight_mant", "w_mant", "weights_mixed")
_EXPONENTS = ("weight_exp", "weight_exponent", "w_exp", "wgt_exp")
_THRESHOLDS = ("vth", "vth_mant", "v_th", "threshold")
# in units of the states, not of the mantissas
_WEIGHTS_EFFECTIVE = ("weights_effective", "weight_effective", "w_effective", "w_eff")
_THRESHOLDS_EFFECTIVE = ("vth_effective", "vth_eff")
_REFRACTORY = ("refractory", "refract_delay", "refractory_period")
_INPUT = ("input_spikes", "input", "inputs", "in", "spikes_in", "s_in", "in_spikes")

# mantissas are shifted by so much to become states; thresholds always are
_SHIFT = 6
# states beyond this are no chip's
_STATE = 1 << 40


def _with_probes(*names: str) -> tuple[str, ...]:
    marked = [(f"{n}_{mark}", f"{mark}_{n}") for n in names for mark in _PROBES]
    return (*names, *(each for pair in marked for each in pair))


_PROBES = ("hw", "chip", "board", "probe")
_RECORDED = {
    "current": (_with_probes("u", "current", "I", "i"), -_STATE, _STATE),
    "membrane": (_with_probes("v", "voltage", "membrane", "v_mem"), -_STATE, _STATE),
    "spikes": (_with_probes("s", "spikes", "s_out", "output_spikes", "out_spikes", "spk"), 0, 1),
}
# given twice in the file, or by the model
_REPEATED = {
    "steps", "params", "layers", "dt", "exc_inh_split", "weights_effective_reported",
    "weights_exc", "weights_inh", "weights_mixed", "effective_decay_u", "effective_decay_v",
    "bias_effective", "bias_mant", "bias_exp", "du", "decay_u", *_EXPONENTS, *_WEIGHTS_EFFECTIVE,
    *_THRESHOLDS_EFFECTIVE, *_INPUT,
}  # fmt: skip
_BEYOND = (
    "{}: dv is 4096, which lava takes and the chip's register of 12 bits does not hold; replayed "
    "as lava computes it, the membrane keeps nothing"
)


def loihi_trace(fields: Fields, chip: str) -> TraceFile:
    """The trace in the fields; one layer at the top, or a list of them under `layers`."""
    specs, on = fields.layers(), datasheet(chip)
    if not isinstance(on.arithmetic, CubaFixedPoint):
        raise fields.wrong("chip", f"{chip} has no integers", "Name a chip that has.")
    rows = table_of(specs[0], _INPUT, 0, 1, index="input_spikes_index")
    width, work = rows.shape[1], Work(fields, len(rows))
    layers, chips, remarks = list[Layer](), list[CubaFixedPoint](), list[str]()
    for place, spec in enumerate(specs):
        weights = _read_weights(spec, on.arithmetic, layers[-1].size if layers else width)
        arithmetic = _with_options(spec, on.arithmetic, weights)
        synapses = _read_synapses(spec, replace(on, arithmetic=arithmetic), place, weights, width)
        work.add(len(weights.mantissa), sum(each.weight.size for each in synapses))
        layer = _read_layer(spec, f"layer{place}", synapses, arithmetic)
        layers.append(layer)
        chips.append(arithmetic)
        if spec.name("dv", "decay_v") and not layer.membrane_decay.all():
            # one more than the register holds, which _decay_factor takes of lava alone
            remarks += [_BEYOND.format(layer.name)] * (arithmetic.exponents == "sum")
    for option in ("refractory", "membrane", "mantissa_shift"):
        if len({getattr(each, option) for each in chips}) > 1:
            raise fields.wrong(option, "differs from layer to layer", "Split the trace in two.")
    program = Program(
        replace(on, arithmetic=chips[0]),
        Convention(1e-3, delay=on.delay, source="the trace"),
        "input",
        width,
        tuple(layers),
        layers[-1].name,
        None,
        clock="pipelined",
    )
    trace = chain_trace(fields, specs, program, rows, [_RECORDED] * len(specs), _REPEATED)
    # a board's probe shows something else where a neuron spikes
    return replace(trace, blind_at_spikes=chip == "loihi2", remarks=(*trace.remarks, *remarks))


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


def _read_weights(spec: Fields, arithmetic: CubaFixedPoint, fan_in: int) -> _Weights:
    effective = spec.name(*_WEIGHTS_EFFECTIVE)
    lists = [name for name in ("weights_exc", "weights_inh") if spec.name(name)]
    if lists:
        tables = [_matrix(spec, name, fan_in) for name in lists]
        if tables[0].shape != tables[-1].shape:
            raise spec.wrong(lists[1], f"has shape {tables[1].shape}", f"Match {lists[0]}.")
        return _Weights(np.asarray(sum(tables)), False, _exponent(spec))
    if effective and spec.name(*_WEIGHTS) is None:
        return _Weights(_matrix(spec, effective, fan_in, 1 << _SHIFT) >> _SHIFT, False, 0)
    name = spec.name(*_WEIGHTS) or _WEIGHTS[0]
    mantissa = _matrix(spec, name, fan_in)
    # lava looks at the weights: a list of one sign spends no bit on it (its weightutils)
    one_sign = arithmetic.exponents == "sum" and (mantissa.min() >= 0 or mantissa.max() <= 0)
    mixed = name == "weights_mixed" or _says_mixed(spec)
    return _Weights(mantissa, mixed and not one_sign, _exponent(spec))


def _says_mixed(spec: Fields) -> bool:
    mode = spec.text("sign_mode").lower()
    return "mixed" in mode or spec.flag("exc_inh_split", None if mode else True) is False


def _exponent(spec: Fields) -> int:
    return spec.integer(*_EXPONENTS, default=0, least=-8, most=7)


def _matrix(spec: Fields, name: str, fan_in: int, unit: int = 1) -> Integers:
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
    # where nothing is rounded, a negative exponent moves the weights by fewer bits
    shift = _SHIFT + min(weights.exponent, 0) * (arithmetic.exponents == "exact")
    if shift < 0:
        found = f"is {weights.exponent}"
        raise spec.wrong("weight_exp", found, f"This model goes down to {-_SHIFT}.")
    bits, refractory = arithmetic.weight_bits, arithmetic.refractory
    return replace(
        arithmetic,
        sign_mode="mixed" if weights.mixed else "split",
        weight_bits=spec.integer("num_weight_bits", default=bits, least=0, most=8),
        refractory=spec.integer(*_REFRACTORY, default=refractory, least=1, most=64),
        mantissa_shift=shift,
        membrane=_membrane(spec, arithmetic.membrane),
    )


def _membrane(spec: Fields, register: Register) -> Register:
    if spec.name("vmin", "vmax") is None:
        spec.assume("vmin and vmax", "of its register")
        return register
    least = spec.integer("vmin", default=-register.limit, least=-_STATE, most=0)
    most = spec.integer("vmax", default=register.limit, least=0, most=_STATE)
    return replace(register, between=(least, most))


def _read_synapses(
    spec: Fields, on: Chip, place: int, weights: _Weights, inputs: int
) -> list[Synapses]:
    """The synapses from the layer before and past it from the input, as lists of the chip."""
    source = f"layer{place - 1}" if place else "input"
    if spec.name("delays") is None:
        found = _stored_lists(spec, on, source, weights)
    else:
        delays = spec.array("delays", axes=2, least=0, most=on.delay_max)
        delays = delays.T if spec.text("index").startswith("[pre]") else delays
        if delays.shape != weights.mantissa.shape:
            remedy = f"Write {weights.mantissa.shape}, as the weights have."
            raise spec.wrong("delays", f"has shape {delays.shape}", remedy)
        found = []
        for delay in np.unique(delays).tolist():
            some = replace(weights, mantissa=np.where(delays == delay, weights.mantissa, 0))
            found += _stored_lists(spec, on, source, some, delay)
    if spec.name("weights_input"):
        mantissa = _matrix(spec, "weights_input", inputs)
        if not place or len(mantissa) != len(weights.mantissa):
            remedy = "Write it for layers behind the first, with a row for each neuron."
            raise spec.wrong("weights_input", f"has shape {mantissa.shape}", remedy)
        found += _stored_lists(spec, on, "input", replace(weights, mantissa=mantissa))
    return found


def _stored_lists(
    spec: Fields, on: Chip, source: str, weights: _Weights, delay: int | None = None
) -> list[Synapses]:
    """The lists of weights that the chip stores, one for each sign where they are summed apart.

    delay: [timesteps] from the spikes of the source; None is that of the file or of the tool.
    """
    arithmetic = on.arithmetic
    if not isinstance(arithmetic, CubaFixedPoint):
        raise TypeError(type(arithmetic).__name__)
    if delay is None and spec.name("delay"):
        delay = int(spec.array("delay", axes=0, least=0, most=on.delay_max))
    elif delay is None:
        # traces of nengo_loihi that were recorded before the field existed meant 0 from the input
        delay = arithmetic.input_delay(on.delay) if source == "input" else on.delay
        spec.assume("delay", f"{delay} from {'the input' if source == 'input' else 'layers'}")
    axons, exponent, shift = weights.mantissa.T, weights.exponent, 0
    stored: list[NDArray[np.int16]]
    if exponent >= 0 or arithmetic.exponents == "weight":
        stored = [drop_low_bits(axons, arithmetic, exponent)]
    elif arithmetic.exponents == "exact":
        stored = [drop_low_bits(axons, arithmetic)]
    else:
        signs = [axons] if weights.mixed else [axons.clip(min=0), axons.clip(max=0)]
        stored, shift = [drop_low_bits(sign, arithmetic) for sign in signs], -exponent
    return [Synapses(source, weight, delay, shift) for weight in stored]


def _read_layer(
    spec: Fields, name: str, synapses: list[Synapses], arithmetic: CubaFixedPoint
) -> Layer:
    size = synapses[0].weight.shape[1]
    if spec.name(*_THRESHOLDS) is None and spec.name(*_THRESHOLDS_EFFECTIVE):
        threshold = spec.row(*_THRESHOLDS_EFFECTIVE, size=size, least=0, most=_STATE)
    else:
        most = arithmetic.threshold_max
        threshold = spec.row(*_THRESHOLDS, size=size, least=0, most=most) << _SHIFT
    return layer_of(
        name,
        synapses,
        threshold,
        _decay_factor(spec, "v", arithmetic, size),
        current_decay=_decay_factor(spec, "u", arithmetic, size),
        voltage_bias=_bias(spec, size),
    )


def _bias(spec: Fields, size: int) -> Integers:
    """(N,) [state units]."""
    name = spec.name("bias", "bias_effective")
    if spec.name("bias_mant") is None or (name and spec.name("bias_exp") is None):
        return spec.row(name or "bias", size=size, default=0, least=-_STATE, most=_STATE)
    mantissa = spec.row("bias_mant", size=size, least=-4096, most=4095)
    exponent = spec.row("bias_exp", size=size, default=0, least=-8, most=7)
    made = np.asarray((mantissa << exponent.clip(min=0)) >> (-exponent).clip(min=0))
    if name and (spec.row(name, size=size, least=-_STATE, most=_STATE) != made).any():
        raise spec.wrong(name, "is not bias_mant times 2^bias_exp", "Leave the wrong one out.")
    return made


def _decay_factor(spec: Fields, state: str, arithmetic: CubaFixedPoint, size: int) -> Integers:
    """(N,) what a timestep leaves, from the register or from what the register does."""
    one = arithmetic.decay_one
    offset = arithmetic.current_decay_offset if state == "u" else arithmetic.membrane_decay_offset
    names, effective = (f"d{state}", f"decay_{state}"), f"effective_decay_{state}"
    if spec.name(*names) is None and spec.name(effective):
        return one - spec.row(effective, size=size, least=0, most=one)
    # without a decay of the current it lasts one timestep
    default = one - offset if state == "u" else None
    # lava's model takes one more than the chip's register holds
    most = max(arithmetic.decay_max, (one - offset) * (arithmetic.exponents == "sum"))
    return one - offset - spec.row(*names, size=size, default=default, least=0, most=most)
