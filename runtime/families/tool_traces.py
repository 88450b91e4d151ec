"""Recorded runs in the formats of tools: of Loihi's emulators, of xylosim, and of Spiker+'s RTL.

    Loihi       one layer, or a list of them under `layers`: lava, brian2_loihi, nengo_loihi, boards
    Xylo        hidden neurons with recurrent synapses, and output neurons: xylosim
    Spiker+     layers as of Loihi, from simulations of its RTL

Registers are read by `programs`. A timestep of Spiker's RTL begins with firing, the emulator's ends
with it: a spike of the emulator leaves in the next timestep of the recording, and its membranes are
those before any firing in both.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.chips.chip import Chip
from spikedeploy.runtime.chips.chip import chip as datasheet
from spikedeploy.runtime.chips.layer import Layer, Synapses
from spikedeploy.runtime.chips.registers import Register
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.convention import Convention, Reset
from spikedeploy.runtime.emulator.interpreter import Interpreter
from spikedeploy.runtime.families.cuba.arithmetic import CubaFixedPoint
from spikedeploy.runtime.families.cuba.quantise import drop_low_bits
from spikedeploy.runtime.families.integrate_and_fire.arithmetic import IntegrateAndFire
from spikedeploy.runtime.families.integrate_and_fire.neurons import PartialStep, begin, fires
from spikedeploy.runtime.families.programs import read_layer
from spikedeploy.runtime.families.xylo import XyloArithmetic
from spikedeploy.runtime.traces.fields import Fields, Integers, Work
from spikedeploy.runtime.traces.verify import STATE, Tables, TraceFile, layers_trace

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
# of Loihi: mantissas are shifted by so much to become states
_SHIFT = 6


def loihi_trace(fields: Fields, chip: str) -> TraceFile:
    """The trace in the fields; weights are `[post][pre]`."""
    specs, on = [spec.spelled(_LOIHI) for spec in fields.layers()], datasheet(chip)
    if not isinstance(on.arithmetic, CubaFixedPoint):
        raise fields.wrong("chip", f"{chip} has no integers", "Name a chip that has.")
    rows = specs[0].table("input_spikes", least=0, most=1)
    work, width = Work(fields, len(rows)), rows.shape[1]
    layers, chips, remarks = list[Layer](), list[CubaFixedPoint](), list[str]()
    for place, spec in enumerate(specs):
        weights = _read_weights(spec, on.arithmetic, layers[-1].size if layers else width)
        arithmetic = _with_options(spec, on.arithmetic, weights)
        synapses = _read_synapses(spec, replace(on, arithmetic=arithmetic), place, weights, width)
        work.add(len(weights.mantissa), sum(each.weight.size for each in synapses))
        layers.append(read_layer(spec, f"layer{place}", synapses, on))
        chips.append(arithmetic)
        if not layers[-1].membrane_decay.all() and arithmetic.exponents == "sum":
            # one more than the register holds, which is taken of lava alone
            remarks.append(_BEYOND.format(layers[-1].name))
    for option in ("refractory", "membrane", "mantissa_shift"):
        if len({getattr(each, option) for each in chips}) > 1:
            raise fields.wrong(option, "differs from layer to layer", "Split the trace in two.")
    convention = Convention(1e-3, delay=on.delay, source="the trace")
    program = _chain(replace(on, arithmetic=chips[0]), convention, width, layers, "pipelined")
    # a board's probe shows something else where a neuron spikes
    blind = chip == "loihi2"
    more = {"blind_at_spikes": blind, "remarks": remarks}
    return layers_trace(fields, specs, program, rows, _REPEATED, **more)


def _chain(
    chip: Chip, convention: Convention, width: int, layers: list[Layer], clock: str = "gated"
) -> Program:
    last = layers[-1].name
    return Program(chip, convention, "input", width, tuple(layers), last, None, clock=clock)  # type: ignore[arg-type]


@dataclass(frozen=True, eq=False)
class _Weights:
    """Weights of Loihi as they were given.

    mantissa: (N, M).
    mixed: whether one list holds both signs, and a bit for them.
    exponent: they count 2**this times.
    """

    mantissa: Integers
    mixed: bool
    exponent: int


def _read_weights(spec: Fields, arithmetic: CubaFixedPoint, fan_in: int) -> _Weights:
    spec.refuse_axes("index", r"^\[pre\]")
    lists = [name for name in ("weights_exc", "weights_inh") if name in spec]
    if lists:
        tables = [_matrix(spec, name, fan_in) for name in lists]
        if tables[0].shape != tables[-1].shape:
            raise spec.wrong(lists[1], f"has shape {tables[1].shape}", f"Match {lists[0]}.")
        return _Weights(np.asarray(sum(tables)), False, _exponent(spec))
    mixed = "weights_mixed" in spec
    mantissa = _matrix(spec, "weights_mixed" if mixed else "weights", fan_in)
    # lava looks at the weights: a list of one sign spends no bit on it (its weightutils)
    one_sign = arithmetic.exponents == "sum" and (mantissa.min() >= 0 or mantissa.max() <= 0)
    mixed = mixed or spec.flag("exc_inh_split", True) is False
    return _Weights(mantissa, mixed and not one_sign, _exponent(spec))


def _exponent(spec: Fields) -> int:
    return spec.integer("weight_exp", default=0, least=-8, most=7)


def _matrix(spec: Fields, name: str, fan_in: int) -> Integers:
    found = spec.array(name, axes=2, least=-256, most=255)
    if found.ndim < 2:
        # one neuron with several axons, or one axon onto several neurons
        found = found.reshape((1, -1) if found.size == fan_in else (-1, 1))
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
    bits = spec.integer("num_weight_bits", default=arithmetic.weight_bits, least=0, most=8)
    refractory = spec.integer("refractory", default=arithmetic.refractory, least=1, most=64)
    membrane = arithmetic.membrane
    if "vmin" in spec or "vmax" in spec:
        least = spec.integer("vmin", default=-membrane.limit, least=-STATE, most=0)
        most = spec.integer("vmax", default=membrane.limit, least=0, most=STATE)
        membrane = replace(membrane, between=(least, most))
    else:
        spec.assume("vmin and vmax", "of its register")
    return replace(
        arithmetic,
        sign_mode="mixed" if weights.mixed else "split",
        weight_bits=bits,
        refractory=refractory,
        mantissa_shift=shift,
        membrane=membrane,
    )


def _read_synapses(
    spec: Fields, on: Chip, place: int, weights: _Weights, inputs: int
) -> list[Synapses]:
    """The synapses from the layer before and past it from the input, as lists of the chip."""
    source = f"layer{place - 1}" if place else "input"
    if "delays" not in spec:
        found = _stored_lists(spec, on, source, weights)
    else:
        delays = spec.array("delays", axes=2, least=0, most=on.delay_max)
        if delays.shape != weights.mantissa.shape:
            remedy = f"Write {weights.mantissa.shape}, as the weights have."
            raise spec.wrong("delays", f"has shape {delays.shape}", remedy)
        found = []
        for delay in np.unique(delays).tolist():
            some = replace(weights, mantissa=np.where(delays == delay, weights.mantissa, 0))
            found += _stored_lists(spec, on, source, some, delay)
    if "weights_input" in spec:
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
    if delay is None and "delay" in spec:
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


def xylo_trace(fields: Fields, chip: str) -> TraceFile:
    """The trace in the fields; weights are `[pre][post][synapse]`."""
    both, used = fields.merged_with(fields.group("params")), datasheet(chip)
    if not isinstance(used.arithmetic, XyloArithmetic):
        raise fields.wrong("chip", f"{chip} does not count events", "Name a Xylo.")
    hidden, output = both.spelled(_HIDDEN), both.spelled(_OUTPUT, alone=True)
    counts = hidden.table("input_spikes", least=0, most=255)
    work, width = Work(fields, len(counts)), counts.shape[1]
    first = _xylo_hidden(hidden, used, width, work)
    weights = _xylo_weights(output, "weights_out", 2, used.arithmetic)
    if weights.shape[2] > 1:
        raise output.wrong("weights_out", f"has shape {weights.shape}", "Outputs have one synapse.")
    if len(weights) != first.size:
        remedy = f"Write a row for each of the {first.size} hidden neurons."
        raise output.wrong("weights_out", f"has {len(weights)} rows", remedy)
    work.add(weights.shape[1], weights.size, len(weights))
    second = read_layer(output, "output", _xylo_synapses("hidden", weights, 1), used)
    convention = Convention(1e-3, reset="subtract", delay=used.delay, source="the trace")
    program = _chain(used, convention, width, [first, second])
    return layers_trace(fields, [hidden, output], program, counts, set())


def _xylo_hidden(spec: Fields, used: Chip, width: int, work: Work) -> Layer:
    weights = _xylo_weights(spec, "weights_in", 0, used.arithmetic)
    if weights.shape[0] != width:
        found, remedy = f"has {weights.shape[0]} rows", f"Write one for each of {width} inputs."
        raise spec.wrong("weights_in", found, remedy)
    size, aliases = weights.shape[1], _aliases(spec, weights.shape[1])
    synapses = _xylo_synapses("input", weights, 0)
    if spec.has_content("weights_rec"):
        recurrent = _xylo_weights(spec, "weights_rec", 1, used.arithmetic)
        if recurrent.shape[:2] != (size, size):
            remedy = f"Write {size} rows of {size} neurons."
            raise spec.wrong("weights_rec", f"has shape {recurrent.shape}", remedy)
        synapses += _xylo_synapses("hidden", recurrent, 1)
    axons = sum(len(s.weight) for s in synapses) + sum(map(len, aliases), len(aliases))
    work.add(size, sum(s.weight.size for s in synapses), axons)
    return replace(read_layer(spec, "hidden", synapses, used), aliases=aliases)


def _xylo_synapses(source: str, weights: Integers, delay: int) -> list[Synapses]:
    return [Synapses(source, weights[:, :, k], delay, current=k) for k in range(weights.shape[2])]


def _aliases(spec: Fields, size: int) -> tuple[tuple[int, ...], ...]:
    """Return the aliases: neurons for which each neuron's spikes count too."""
    if not spec.has_content("aliases"):
        return ()
    rows = spec.lists("aliases", least=0, most=size - 1)
    if len(rows) != size:
        raise spec.wrong("aliases", f"has {len(rows)} lists", f"Write {size}, one for each neuron.")
    if own := [n for n, others in enumerate(rows) if n in others]:
        raise spec.wrong("aliases", f"of neuron {own[0]} name itself", "Name other neurons.")
    return rows


def _xylo_weights(spec: Fields, name: str, place: int, registers: object) -> Integers:
    """(M, N, K) weights as they are added, after the shift of their matrix."""
    if not isinstance(registers, XyloArithmetic):
        raise TypeError(type(registers).__name__)
    edge = 1 << (registers.weight_bits - 1)
    found = spec.array(name, axes=3, least=-edge, most=edge - 1)
    if found.ndim == 1:  # a single neuron, one weight for each of its inputs
        found = found[:, None]
    if found.ndim < 2:
        raise spec.wrong(name, "is a single number", "Write [pre][post][synapse].")
    found = found.reshape(*found.shape[:2], -1)
    if found.shape[2] > registers.currents:
        remedy = f"A neuron has {registers.currents} synapses at most."
        raise spec.wrong(name, f"has shape {found.shape}", remedy)
    # rockpool's specification has a field for each matrix
    alone, most = f"weight_shift_{name.removeprefix('weights_')}", registers.shift_max
    if alone in spec:
        return np.asarray(found << spec.row(alone, size=1, least=0, most=most))
    return np.asarray(
        found << spec.row("weight_shift", size=3, default=0, least=0, most=most)[place]
    )


# of a layer of Spiker+; of an FPGA there is no limit, a trace of more is a mistake
_MOST_NEURONS = 1 << 12


def spiker_trace(fields: Fields, chip: str) -> TraceFile:
    """The trace in the fields; weights are `[pre][post]`."""
    specs, on = [spec.spelled(_SPIKER) for spec in fields.layers()], datasheet(chip)
    if not isinstance(on.arithmetic, IntegrateAndFire):
        raise fields.wrong("chip", f"{chip} does not leak by shifts", "Name spiker.")
    counts = specs[0].table("input_spikes", least=0, most=255)
    work = Work(fields, len(counts))
    work.check_input(counts)
    bits = _same(specs, "weight_bits", on.arithmetic.weight_bits, most=16)
    neuron_bits = _same(specs, "neuron_bits", on.arithmetic.membrane.bits, most=32)
    register = Register(neuron_bits, on.arithmetic.membrane.overflow)
    rules = replace(on.arithmetic, weight_bits=bits, membrane=register)
    used, layers = replace(on, arithmetic=rules), list[Layer]()
    resets = {spec.choice("reset", ("subtract", "fixed")) for spec in specs}
    if len(resets) > 1:
        raise specs[0].wrong("reset", "differs from layer to layer", "Split the trace in two.")
    for place, spec in enumerate(specs):
        source, fan_in = ("input", counts.shape[1])
        if layers:
            source, fan_in = layers[-1].name, layers[-1].size
        synapses = _spiker_synapses(spec, f"layer{place}", rules, source, fan_in)
        layers.append(read_layer(spec, f"layer{place}", synapses, used))
        weights = [s.weight for s in synapses]
        work.add(layers[-1].size, sum(w.size for w in weights), sum(map(len, weights)))
    reset: Reset = "subtract" if resets == {"subtract"} else "zero"
    convention = Convention(1e-3, reset=reset, source="the trace")
    program = _chain(used, convention, counts.shape[1], layers)
    return layers_trace(fields, specs, program, counts, {"input_spikes"}, replay=_replay_spiker)


def _same(specs: list[Fields], name: str, default: int, most: int) -> int:
    found = {spec.integer(name, default=default, least=2, most=most) for spec in specs}
    if len(found) > 1:
        raise specs[0].wrong(name, "differs from layer to layer", "Split the trace in two.")
    return found.pop()


def _spiker_synapses(
    spec: Fields, name: str, rules: IntegrateAndFire, source: str, fan_in: int
) -> list[Synapses]:
    spec.refuse_axes("index", r"^\[post\]")
    low, high = rules.weight_range
    weights = spec.array("weights", axes=2, least=low, most=high)
    if weights.ndim != 2 or len(weights) != fan_in or weights.shape[1] > _MOST_NEURONS:
        remedy = f"Write {fan_in} rows, one for each input, of {_MOST_NEURONS} neurons at most."
        raise spec.wrong("weights", f"has shape {weights.shape}", remedy)
    synapses = [Synapses(source, weights, 0 if source == "input" else 2)]
    if spec.has_content("weights_rec"):
        # their width is a parameter of its own, which no field names
        low, high = replace(rules, weight_bits=16).weight_range
        recurrent, size = spec.array("weights_rec", axes=2, least=low, most=high), weights.shape[1]
        if recurrent.shape != (size, size):
            found = f"has shape {recurrent.shape}"
            raise spec.wrong("weights_rec", found, f"Write {size} rows of {size} neurons.")
        synapses.append(Synapses(name, recurrent, 2))
    return synapses


def _replay_spiker(program: Program, raster: NDArray[np.uint8]) -> Tables:
    """Tables in the timesteps of the RTL."""
    rules = program.chip.arithmetic
    if not isinstance(rules, IntegrateAndFire):
        raise TypeError(type(rules).__name__)
    interpreter = Interpreter(program, 1)
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
