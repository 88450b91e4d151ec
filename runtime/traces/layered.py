"""Recorded runs of layers by the names that tools write, each layer presynaptic to the next.

    Loihi       lava, brian2_loihi, nengo_loihi, boards
    Xylo        xylosim: hidden neurons with recurrent synapses, and output neurons
    Spiker+     simulations of its RTL

Registers are read by `programs`. A timestep of Spiker's RTL begins with firing, the emulator's ends
with it: a spike of the emulator leaves in the next timestep of the recording, and its membranes are
those before any firing in both.
"""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.chips.chip import Chip
from spikedeploy.runtime.chips.chip import chip as datasheet
from spikedeploy.runtime.chips.layer import Layer, Synapses
from spikedeploy.runtime.chips.registers import Register
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.emulator.interpreter import Interpreter
from spikedeploy.runtime.families.cuba.arithmetic import CubaFixedPoint
from spikedeploy.runtime.families.cuba.quantise import drop_low_bits
from spikedeploy.runtime.families.integrate_and_fire.arithmetic import IntegrateAndFire
from spikedeploy.runtime.families.integrate_and_fire.neurons import PartialStep, begin, fires
from spikedeploy.runtime.families.xylo import XyloArithmetic
from spikedeploy.runtime.traces.fields import Fields, Integers
from spikedeploy.runtime.traces.programs import read_layer
from spikedeploy.runtime.traces.verdict import STATE, Tables, TraceFile, layers_trace

_Rules = TypeVar("_Rules", CubaFixedPoint, IntegrateAndFire)

# names of tools -> ours
_LOIHI = {
    "du": "decay_u", "dv": "decay_v", "vth_mant": "vth", "refract_delay": "refractory",
    "u": "current", "v": "membrane", "s": "spikes",
}  # fmt: skip
_HIDDEN = {
    "input_counts": "input_spikes", "i_syn": "current", "i_syn2": "current 2",
    "v_mem": "membrane", "hidden_spikes": "spikes",
}  # fmt: skip
_OUTPUT = {
    "i_syn_out": "current", "v_mem_out": "membrane", "out_spikes": "spikes",
    "dash_syn_out": "dash_syn", "dash_syn_2_out": "dash_syn_2", "dash_mem_out": "dash_mem",
    "threshold_out": "threshold", "bias_out": "bias",
}  # fmt: skip
_SPIKER = {"v_begun": "membrane after fire or leak", "v": "membrane", "s": "spikes"}
# given twice in the file, or by the model
_REPEATED = {
    "dt", "exc_inh_split", "weights_effective_reported", "weights_exc", "weights_inh",
    "weights_mixed", "effective_decay_u", "effective_decay_v", "vth_effective", "bias_effective",
    "bias_mant", "bias_exp", "decay_u", "weight_exp", "input_spikes",
}  # fmt: skip
_BEYOND = (
    "{}: dv is 4096, which lava takes and the chip's register of 12 bits does not hold; replayed "
    "as lava computes it, the membrane keeps nothing"
)
_MANTISSA_SHIFT = 6  # of Loihi: mantissas are shifted by so much to become states


def _chain(
    chip: Chip, convention: Convention, width: int, layers: list[Layer], clock: str = "gated"
) -> Program:
    last = layers[-1].name
    return Program(chip, convention, "input", width, tuple(layers), last, None, clock=clock)  # type: ignore[arg-type]


def _shared(fields: Fields, what: str, found: list[Any]) -> Any:  # noqa: ANN401
    """The value that all layers have; TraceError where they differ."""
    if any(each != found[0] for each in found):
        raise fields.wrong(what, "differs from layer to layer", "Split the trace in two.")
    return found[0]


def _matrix(spec: Fields, name: str, shape: tuple[int, int], least: int, most: int) -> Integers:
    """Weights of this shape (rows, columns); -1 stands for any number of columns."""
    found = spec.array(name, axes=2, least=least, most=most)
    if found.ndim != 2 or len(found) != shape[0] or shape[1] not in (-1, found.shape[1]):
        columns = "" if shape[1] < 0 else f" of {shape[1]}"
        raise spec.wrong(
            name, f"has shape {found.shape}", f"Write {shape[0]} rows{columns}, one for each input."
        )
    return found


# Loihi


def loihi_trace(fields: Fields, chip: str) -> TraceFile:
    """The trace in the fields; weights are `[post][pre]`."""
    specs, on = [spec.spelled(_LOIHI) for spec in fields.layers()], datasheet(chip)
    counts = specs[0].table("input_spikes", least=0, most=1)
    layers, rules, remarks = list[Layer](), list[CubaFixedPoint](), list[str]()
    for place, spec in enumerate(specs):
        source, fan_in = (layers[-1].name, layers[-1].size) if layers else ("input", len(counts.T))
        spec.refuse_axes("index", r"^\[pre\]")
        weights, is_mixed = _loihi_weights(spec, _rules(on, CubaFixedPoint), fan_in)
        rules.append(_with_options(spec, _rules(on, CubaFixedPoint), is_mixed))
        parts = _loihi_parts(spec, on, source, weights, counts.shape[1])
        stored = [Synapses(*each) for part in parts for each in _stored(spec, rules[-1], *part)]
        layers.append(read_layer(spec, f"layer{place}", stored, on))
        if not layers[-1].membrane_decay.all() and rules[-1].exponents == "sum":
            # one more than the register holds, which is taken of lava alone
            remarks.append(_BEYOND.format(layers[-1].name))
    for option in ("refractory", "membrane", "mantissa_shift"):
        _shared(fields, option, [getattr(each, option) for each in rules])
    convention = Convention(1e-3, delay=on.delay, source="the trace")
    chip_run = replace(on, arithmetic=rules[0])
    program = _chain(chip_run, convention, counts.shape[1], layers, "pipelined")
    # a board's probe shows something else where a neuron spikes
    blind = chip == "loihi2"
    more = {"blind_at_spikes": blind, "remarks": remarks}
    return layers_trace(fields, specs, program, counts, _REPEATED, **more)


def _rules(on: Chip, kind: type[_Rules]) -> _Rules:
    if not isinstance(on.arithmetic, kind):
        raise TypeError(type(on.arithmetic).__name__)
    return on.arithmetic


def _loihi_weights(spec: Fields, rules: CubaFixedPoint, fan_in: int) -> tuple[Integers, bool]:
    """Mantissas (N, M), and whether one list holds both signs and a bit for them."""
    by_sign = [_post_pre(spec, n, fan_in) for n in ("weights_exc", "weights_inh") if n in spec]
    if by_sign:
        if by_sign[0].shape != by_sign[-1].shape:
            found = f"has shape {by_sign[1].shape}"
            raise spec.wrong("weights_inh", found, "Match weights_exc.")
        return np.asarray(sum(by_sign)), False
    is_mixed = "weights_mixed" in spec
    weights = _post_pre(spec, "weights_mixed" if is_mixed else "weights", fan_in)
    # lava looks at the weights: a list of one sign spends no bit on it (its weightutils)
    one_sign = rules.exponents == "sum" and (weights.min() >= 0 or weights.max() <= 0)
    is_mixed = is_mixed or not spec.flag("exc_inh_split", True)
    return weights, is_mixed and not one_sign


def _post_pre(spec: Fields, name: str, fan_in: int) -> Integers:
    found = spec.array(name, axes=2, least=-256, most=255)
    if found.ndim < 2:
        # one neuron with several axons, or one axon onto several neurons
        found = found.reshape((1, -1) if found.size == fan_in else (-1, 1))
    if found.shape[1] != fan_in:
        remedy = f"Write a row for each neuron, with {fan_in} weights, one for each input."
        raise spec.wrong(name, f"has shape {found.shape}", remedy)
    return found


def _exponent(spec: Fields) -> int:
    return spec.integer("weight_exp", default=0, least=-8, most=7)


def _with_options(spec: Fields, rules: CubaFixedPoint, is_mixed: bool) -> CubaFixedPoint:
    # where nothing is rounded, a negative exponent moves the weights by fewer bits
    exponent = _exponent(spec)
    shift = _MANTISSA_SHIFT + min(exponent, 0) * (rules.exponents == "exact")
    if shift < 0:
        remedy = f"This model goes down to {-_MANTISSA_SHIFT}."
        raise spec.wrong("weight_exp", f"is {exponent}", remedy)
    bits = spec.integer("num_weight_bits", default=rules.weight_bits, least=0, most=8)
    refractory = spec.integer("refractory", default=rules.refractory, least=1, most=64)
    membrane = rules.membrane
    if "vmin" in spec or "vmax" in spec:
        least = spec.integer("vmin", default=-membrane.limit, least=-STATE, most=0)
        most = spec.integer("vmax", default=membrane.limit, least=0, most=STATE)
        membrane = replace(membrane, between=(least, most))
    else:
        spec.assume("vmin and vmax", "of its register")
    return replace(
        rules,
        sign_mode="mixed" if is_mixed else "split",
        weight_bits=bits,
        refractory=refractory,
        mantissa_shift=shift,
        membrane=membrane,
    )


def _loihi_parts(
    spec: Fields, on: Chip, source: str, weights: Integers, inputs: int
) -> Iterator[tuple[str, Integers, int]]:
    """Source, mantissas (N, M) and delay of the synapses of a layer."""
    if "delays" in spec:
        delays = spec.array("delays", axes=2, least=0, most=on.delay_max)
        if delays.shape != weights.shape:
            remedy = f"Write {weights.shape}, as the weights have."
            raise spec.wrong("delays", f"has shape {delays.shape}", remedy)
        for delay in np.unique(delays).tolist():
            yield source, np.where(delays == delay, weights, 0), delay
    else:
        yield source, weights, _delay(spec, on, source)
    if "weights_input" in spec:
        skipping = _post_pre(spec, "weights_input", inputs)
        if source == "input" or len(skipping) != len(weights):
            remedy = "Write it for layers behind the first, with a row for each neuron."
            raise spec.wrong("weights_input", f"has shape {skipping.shape}", remedy)
        yield "input", skipping, _delay(spec, on, "input")


def _delay(spec: Fields, on: Chip, source: str) -> int:
    """The delay that the file gives for all synapses, or the tool's."""
    if "delay" in spec:
        return spec.integer("delay", default=0, least=0, most=on.delay_max)
    # traces of nengo_loihi that were recorded before the field existed meant 0 from the input
    is_input = source == "input"
    delay = on.arithmetic.input_delay(on.delay) if is_input else on.delay
    spec.assume("delay", f"{delay} from {'the input' if is_input else 'layers'}")
    return delay


def _stored(
    spec: Fields, rules: CubaFixedPoint, source: str, weights: Integers, delay: int
) -> Iterator[tuple[str, NDArray[np.int16], int, int]]:
    """Arguments of Synapses for each list of weights that the chip stores and sums apart."""
    axons, exponent = weights.T, _exponent(spec)
    if exponent >= 0 or rules.exponents == "weight":
        yield source, drop_low_bits(axons, rules, exponent), delay, 0
    elif rules.exponents == "exact":
        yield source, drop_low_bits(axons, rules), delay, 0
    else:
        is_mixed = rules.sign_mode == "mixed"
        for sign in [axons] if is_mixed else [axons.clip(min=0), axons.clip(max=0)]:
            yield source, drop_low_bits(sign, rules), delay, -exponent


# Xylo


def xylo_trace(fields: Fields, chip: str) -> TraceFile:
    """The trace in the fields; weights are `[pre][post][synapse]`."""
    both, on = fields.merged_with(fields.group("params")), datasheet(chip)
    hidden, output = both.spelled(_HIDDEN), both.spelled(_OUTPUT, alone=True)
    counts = hidden.table("input_spikes", least=0, most=255)
    incoming = _xylo_weights(hidden, "weights_in", 0, on, counts.shape[1])
    size = incoming.shape[1]
    synapses = _by_current("input", incoming, 0)
    if hidden.has_content("weights_rec"):
        recurrent = _xylo_weights(hidden, "weights_rec", 1, on, size)
        if recurrent.shape[1] != size:
            remedy = f"Write {size} rows of {size} neurons."
            raise hidden.wrong("weights_rec", f"has shape {recurrent.shape}", remedy)
        synapses += _by_current("hidden", recurrent, 1)
    aliases = _aliases(hidden, size)
    first = replace(read_layer(hidden, "hidden", synapses, on), aliases=aliases)
    outgoing = _xylo_weights(output, "weights_out", 2, on, size)
    if outgoing.shape[2] > 1:
        found = f"has shape {outgoing.shape}"
        raise output.wrong("weights_out", found, "Outputs have one synapse.")
    second = read_layer(output, "output", _by_current("hidden", outgoing, 1), on)
    convention = Convention(1e-3, reset="subtract", delay=on.delay, source="the trace")
    program = _chain(on, convention, counts.shape[1], [first, second])
    return layers_trace(fields, [hidden, output], program, counts, set())


def _by_current(source: str, weights: Integers, delay: int) -> list[Synapses]:
    return [Synapses(source, weights[:, :, k], delay, current=k) for k in range(weights.shape[2])]


def _aliases(spec: Fields, size: int) -> tuple[tuple[int, ...], ...]:
    """Return the aliases: neurons for which each neuron's spikes count too."""
    if not spec.has_content("aliases"):
        return ()
    rows = spec.lists("aliases", count=size, most=size - 1)
    if own := [n for n, others in enumerate(rows) if n in others]:
        raise spec.wrong("aliases", f"of neuron {own[0]} name itself", "Name other neurons.")
    return tuple(map(tuple, rows))


def _xylo_weights(spec: Fields, name: str, place: int, on: Chip, rows: int) -> Integers:
    """(M, N, K) weights as they are added, after the shift of their matrix."""
    rules = on.arithmetic
    if not isinstance(rules, XyloArithmetic):
        raise TypeError(type(rules).__name__)
    edge = 1 << (rules.weight_bits - 1)
    found = spec.array(name, axes=3, least=-edge, most=edge - 1)
    if found.ndim == 0:
        raise spec.wrong(name, "is a single number", "Write [pre][post][synapse].")
    # a single neuron may have one weight for each of its inputs
    found = found.reshape(len(found), found.shape[1] if found.ndim > 1 else 1, -1)
    if len(found) != rows:
        raise spec.wrong(name, f"has {len(found)} rows", f"Write one for each of {rows} sources.")
    if found.shape[2] > rules.currents:
        remedy = f"A neuron has {rules.currents} synapses at most."
        raise spec.wrong(name, f"has shape {found.shape}", remedy)
    # rockpool's specification has a field for each matrix
    alone, most = f"weight_shift_{name.removeprefix('weights_')}", rules.shift_max
    if alone in spec:
        return np.asarray(found << spec.row(alone, size=1, least=0, most=most))
    shifts = spec.row("weight_shift", size=3, default=0, least=0, most=most)
    return np.asarray(found << shifts[place])


# Spiker+


def spiker_trace(fields: Fields, chip: str) -> TraceFile:
    """The trace in the fields; weights are `[pre][post]`."""
    specs, on = [spec.spelled(_SPIKER) for spec in fields.layers()], datasheet(chip)
    counts = specs[0].table("input_spikes", least=0, most=255)
    rules = _rules(on, IntegrateAndFire)
    widths = {"weight_bits": (rules.weight_bits, 16), "neuron_bits": (rules.membrane.bits, 32)}
    bits = {
        name: _shared(
            fields, name, [s.integer(name, default=own, least=2, most=most) for s in specs]
        )
        for name, (own, most) in widths.items()
    }
    register = Register(bits["neuron_bits"], rules.membrane.overflow)
    rules = replace(rules, weight_bits=bits["weight_bits"], membrane=register)
    used, layers = replace(on, arithmetic=rules), list[Layer]()
    reset = _shared(
        fields, "reset", [s.choice("reset", ("subtract", "fixed"), "subtract") for s in specs]
    )
    for place, spec in enumerate(specs):
        source, fan_in = (layers[-1].name, layers[-1].size) if layers else ("input", len(counts.T))
        spec.refuse_axes("index", r"^\[post\]")
        weights = _matrix(spec, "weights", (fan_in, -1), *rules.weight_range)
        synapses = [Synapses(source, weights, 2 if layers else 0)]
        if spec.has_content("weights_rec"):
            # their width is a parameter of its own, which no field names
            low, high = replace(rules, weight_bits=16).weight_range
            square = (weights.shape[1], weights.shape[1])
            recurrent = _matrix(spec, "weights_rec", square, low, high)
            synapses.append(Synapses(f"layer{place}", recurrent, 2))
        layers.append(read_layer(spec, f"layer{place}", synapses, used))
    convention = Convention(1e-3, reset="zero" if reset == "fixed" else reset, source="the trace")
    program = _chain(used, convention, counts.shape[1], layers)
    return layers_trace(fields, specs, program, counts, {"input_spikes"}, replay=_replay_spiker)


def _replay_spiker(program: Program, raster: NDArray[np.uint8]) -> Tables:
    """Tables in the timesteps of the RTL."""
    rules, interpreter = _rules(program.chip, IntegrateAndFire), Interpreter(program, 1)
    for layer in program.layers:
        # what is above a negative threshold at first was so before
        at_rest = fires(rules, layer.threshold, np.zeros(layer.size, np.int64))
        interpreter.tails[layer.name][:, -1:] = at_rest
    ran, found = interpreter.run(raster), {}
    for layer in program.layers:
        membrane = ran[layer.name].membrane[0]
        before = np.concatenate([np.zeros((1, layer.size), np.int64), membrane[:-1]])
        begun = PartialStep.from_membrane(before)
        begin(rules, program.convention, layer, begun)
        found[layer.name] = {
            _SPIKER["v_begun"]: begun.membrane,
            "membrane": membrane,
            "spikes": fires(rules, layer.threshold, before).astype(np.int64),
        }
    return found
