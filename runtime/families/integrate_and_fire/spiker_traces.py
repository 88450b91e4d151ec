"""Recorded runs of Spiker+, from simulations of the VHDL that its generator writes.

The RTL's timestep begins with firing, the emulator's ends with it: a spike of the emulator leaves
in the next timestep of the recording, and its membranes are those before any firing in both.
"""

from dataclasses import replace

import numpy as np

from spikedeploy.runtime.chips.chip import Chip
from spikedeploy.runtime.chips.chip import chip as datasheet
from spikedeploy.runtime.chips.layer import Layer, Synapses
from spikedeploy.runtime.chips.registers import Register
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.convention import Convention, Reset
from spikedeploy.runtime.emulator.interpreter import Interpreter
from spikedeploy.runtime.families.integrate_and_fire.arithmetic import IntegrateAndFire
from spikedeploy.runtime.families.integrate_and_fire.neurons import PartialStep, begin, fires
from spikedeploy.runtime.traces.fields import Fields, Integers, Work, shown_names
from spikedeploy.runtime.traces.verify import (
    PROSE,
    Verdict,
    first_difference,
    nothing_to_compare,
    recorded_tables,
    table_of,
    weights_of,
)

_BEGUN = "membrane after fire or leak"
# quantity -> its name in the file, and what it may be
_TABLES = {
    _BEGUN: ("v_begun", -1 << 32, 1 << 32),
    "membrane": ("v", -1 << 32, 1 << 32),
    "spikes": ("s", 0, 1),
}
# given twice in the file, or by the weights
_REPEATED = {"params", "layers", "steps", "input_spikes", "chip"}
# of a layer; of an FPGA there is no limit, a trace of more is a mistake
_MOST_NEURONS = 1 << 12


def spiker_verdict(fields: Fields, chip: str) -> Verdict:
    """Whether the layers do what the file says, in every timestep."""
    specs = _layers_of(fields)
    counts = table_of(specs[0], ("input_spikes",), 0, 255, index="input_spikes_index")
    program = _program(specs, datasheet(chip), counts.shape[1])
    work = Work(fields, len(counts))
    work.check_input(counts)
    for layer in program.layers:
        weights = [synapses.weight for synapses in layer.synapses]
        work.add(layer.size, sum(each.size for each in weights), sum(map(len, weights)))
    recorded = {
        layer.name: recorded_tables(spec, _TABLES, (len(counts), layer.size))
        for layer, spec in zip(program.layers, specs, strict=True)
    }
    unread = set.intersection(*(spec.unread for spec in specs)) - PROSE - _REPEATED
    if not any(recorded.values()):
        raise nothing_to_compare(fields, unread, "v, v_begun or s")
    found = _replayed(program, counts)
    return Verdict(
        chip=chip,
        source=fields.text("source") or fields.text("name") or chip,
        steps=len(counts),
        compared=sum(table.size for tables in recorded.values() for table in tables.values()),
        passed_over=0,
        why="",
        difference=first_difference(recorded, found, {}),
        unread=tuple(sorted(unread)),
    )


def _layers_of(fields: Fields) -> list[Fields]:
    """The fields of each layer, then those that the file gives for all."""
    shared = fields.under(fields.group("params"))
    if fields.name("layers") is None:
        return [shared]
    layers = fields.groups("layers")
    return [shared.under(layer, layer.group("params"), where=layer.where) for layer in layers]


def _program(specs: list[Fields], chip: Chip, width: int) -> Program:
    """The layers one after another, on the chip with the widths that they name."""
    arithmetic = chip.arithmetic
    if not isinstance(arithmetic, IntegrateAndFire):
        raise specs[0].wrong("chip", f"{chip.name} does not leak by shifts", "Name spiker.")
    bits = _same(specs, "weight_bits", arithmetic.weight_bits, most=16)
    neuron_bits = _same(specs, "neuron_bits", arithmetic.membrane.bits, most=32)
    register = Register(neuron_bits, arithmetic.membrane.overflow)
    rules = replace(arithmetic, weight_bits=bits, membrane=register)
    resets = {spec.text("reset") or "subtract" for spec in specs}
    if len(resets) > 1 or not resets <= {"subtract", "fixed"}:
        found = f"is {shown_names(sorted(resets))}"
        raise specs[0].wrong("reset", found, "Write 'subtract' or 'fixed', in all layers the same.")
    reset: Reset = "subtract" if resets == {"subtract"} else "zero"
    layers = list[Layer]()
    for place, spec in enumerate(specs):
        source, fan_in = (layers[-1].name, layers[-1].size) if layers else ("input", width)
        layers.append(_layer(spec, f"layer{place}", rules, source, fan_in))
    convention = Convention(1e-3, reset=reset, source="the trace")
    used = replace(chip, arithmetic=rules)
    return Program(used, convention, "input", width, tuple(layers), layers[-1].name, None)


def _same(specs: list[Fields], name: str, default: int, most: int) -> int:
    """A width that all layers share."""
    found = {spec.whole(name, default=default, least=2, most=most) for spec in specs}
    if len(found) > 1:
        raise specs[0].wrong(name, "differs from layer to layer", "Split the trace in two.")
    return found.pop()


def _layer(spec: Fields, name: str, rules: IntegrateAndFire, source: str, fan_in: int) -> Layer:
    weights = weights_of(spec, "weights", *rules.weight_range)
    size, limit = weights.shape[1], rules.membrane.limit
    if len(weights) != fan_in or size > _MOST_NEURONS:
        remedy = f"Write {fan_in} rows, one for each input, of {_MOST_NEURONS} neurons at most."
        raise spec.wrong("weights", f"has shape {weights.shape}", remedy)
    synapses = [Synapses(source, weights, 0 if source == "input" else 2)]
    if spec.name("weights_rec"):
        # their width is a parameter of its own, which no field names
        recurrent = weights_of(spec, "weights_rec", *replace(rules, weight_bits=16).weight_range)
        if recurrent.shape != (size, size):
            found = f"has shape {recurrent.shape}"
            raise spec.wrong("weights_rec", found, f"Write {size} rows of {size} neurons.")
        synapses.append(Synapses(name, recurrent, 2))
    none = np.zeros(size, np.int64)
    return Layer(
        name=name,
        synapses=tuple(synapses),
        bias=none,
        voltage_bias=none,
        threshold=spec.row("threshold", size=size, least=-limit - 1, most=limit),
        current_decay=none,
        membrane_decay=spec.row("shift", size=size, least=0, most=62),
        scale=1.0,
        start=0,
        v_reset=spec.row("v_reset", size=size, default=0, least=-limit - 1, most=limit),
    )


def _replayed(program: Program, counts: Integers) -> dict[str, dict[str, Integers]]:
    """Layer -> quantity -> (T, N), in the timesteps of the RTL."""
    rules = program.chip.arithmetic
    if not isinstance(rules, IntegrateAndFire):
        raise TypeError(type(rules).__name__)
    interpreter = Interpreter(program, 1)
    for layer in program.layers:
        # what is above a negative threshold at first was so before
        interpreter.tails[layer.name][:, -1:] = fires(rules, layer, np.zeros(layer.size, np.int64))
    ran = interpreter.run(counts.astype(np.uint8)[None])
    found = {}
    for layer in program.layers:
        membrane = ran[layer.name].membrane[0]
        before = np.concatenate([np.zeros((1, layer.size), np.int64), membrane[:-1]])
        begun = PartialStep.of(before)
        begin(rules, program.convention, layer, begun)
        spikes = fires(rules, layer, before).astype(np.int64)
        found[layer.name] = {_BEGUN: begun.membrane, "membrane": membrane, "spikes": spikes}
    return found
