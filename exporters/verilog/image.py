"""The image of a program: contents of the core's memories, and the widths of its registers."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from spikedeploy.exporters.c.plan import LayerPlan, Plan
from spikedeploy.exporters.verilog.refusals import check_membranes, check_program
from spikedeploy.runtime.chips.registers import Register
from spikedeploy.runtime.codec.codec import Codec
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.families.cuba.arithmetic import CubaFixedPoint

Integers = NDArray[np.int64]
# target and weight of each synapse of an axon
SynapseRow = tuple[tuple[int, int], ...]

# tokens behind those of axons: the end of a timestep, and before it the start of an episode
STEP, FORGET = 0x8000, 0x8001
# bits of a synapse that a block RAM of the iCE40 holds side by side
_WORD = 16
# a gap between targets that is narrower takes too many synapses of weight 0
_NARROWEST_GAP = 3
_KINDS = {"none": 0, "wrap": 1, "wrap-once": 2, "clip": 3, "saturate": 4}


@dataclass(frozen=True)
class OutputWords:
    """A layer that the host reads, as its words leave.

    layer: its name in the program.
    silent: whether its membranes leave, one a word, and not its spikes, 32 a word.
    neurons: N of it.
    """

    layer: str
    silent: bool
    neurons: int

    @property
    def words(self) -> int:
        """Words of a timestep."""
        return self.neurons if self.silent else -(-self.neurons // 32)


@dataclass(frozen=True)
class NeuronField:
    """A number for each neuron, and where it is stored.

    bits: as wide as it gets.
    values: (N,) of the neurons; where None it does not matter.
    at: its lowest bit in the parameters of a neuron; -1 where neurons of a layer have the same.
    of_layer: value of each layer where they do, else empty.
    """

    bits: int
    values: tuple[int | None, ...]
    at: int = -1
    of_layer: tuple[int, ...] = ()


@dataclass(frozen=True)
class Rows:
    """Rows of synapses, each stored once.

    words: {last, gap, weight} of each synapse.
    gap_bits, weight_bits: of a word.
    starts: of each axon: the first synapse of its row, and whether weights are subtracted.
    first: target from which the gaps of a row count, of the input's channels and of neurons.
    """

    words: tuple[int, ...]
    gap_bits: int
    weight_bits: int
    starts: tuple[tuple[int, bool], ...]
    first: tuple[int, int]

    @property
    def bits(self) -> int:
        """Bits of a word."""
        return 1 + self.gap_bits + self.weight_bits

    @property
    def address_bits(self) -> int:
        """Bits of the number of a word; one behind the last is read ahead, too."""
        return unsigned_bits(len(self.words))

    @property
    def entry_bits(self) -> int:
        """Bits of {negate, first synapse}."""
        return 1 + self.address_bits

    @property
    def lengths(self) -> Integers:
        """Synapses of each axon's row, fillers among them."""
        lasts = np.flatnonzero([word >> (self.bits - 1) for word in self.words])
        firsts = np.array([first for first, _ in self.starts])
        return np.asarray(lasts[np.searchsorted(lasts, firsts)] - firsts + 1)

    def entry(self, axon: int) -> int:
        """{negate, first synapse} of an axon."""
        first, negated = self.starts[axon]
        return negated << self.address_bits | first


def unsigned_bits(most: int) -> int:
    """Bits of a register of 0 to `most`, at least 1."""
    return max(1, most.bit_length())


def signed_bits(most: int) -> int:
    """Bits of a signed register of -most to most."""
    return most.bit_length() + 1


@dataclass(frozen=True, eq=False)
class CoreImage:
    """A program as the core has it.

    plan: of the program.
    """

    plan: Plan

    @property
    def program(self) -> Program:
        """The program."""
        return self.plan.program

    @property
    def axons(self) -> int:
        """Channels of the input."""
        return self.program.width

    @cached_property
    def first(self) -> Mapping[str, int]:
        """Number of the first neuron of each layer; neurons of all layers are numbered."""
        ends = np.cumsum([0, *(layer.size for layer in self.program.layers)]).tolist()
        return {layer.name: end for layer, end in zip(self.program.layers, ends, strict=False)}

    @cached_property
    def neurons(self) -> int:
        """Neurons of all layers."""
        return sum(layer.size for layer in self.program.layers)

    @cached_property
    def neuron_bits(self) -> int:
        """Bits of the number of a neuron."""
        return unsigned_bits(self.neurons - 1)

    @cached_property
    def lags(self) -> tuple[int, int]:
        """Least and largest lag [timesteps] of the synapses."""
        lags = [lag for each in self.program.lags for lag in each]
        return min(lags), max(lags)

    @cached_property
    def slots(self) -> int:
        """Accumulators of a neuron: a power of two above the largest lag."""
        return 1 << self.lags[1].bit_length()

    @cached_property
    def outputs(self) -> tuple[OutputWords, ...]:
        """Layers that the host reads, in the order of their words."""
        return tuple(
            OutputWords(layer.name, not layer.spiking, layer.size)
            for layer in self.program.layers
            if layer.name in self.program.output_layers
        )

    @property
    def words(self) -> int:
        """Words that leave in a timestep."""
        return sum(output.words for output in self.outputs)

    @cached_property
    def last_heard(self) -> int:
        """The neuron with which the last word leaves."""
        last = self.outputs[-1]
        return self.first[last.layer] + last.neurons - 1

    @cached_property
    def rows(self) -> Rows:
        """Rows of the input's channels, then of the neurons."""
        neurons = [
            row for layer in self.program.layers for row in self._rows_of(layer.name, layer.size)
        ]
        inputs = self._rows_of(self.program.input, self.axons)
        return _store_rows(inputs, neurons, self.target_bits)

    @property
    def target_bits(self) -> int:
        """Bits of a target: slots from now, and neuron."""
        return unsigned_bits(self.slots - 1) + self.neuron_bits

    def _rows_of(self, source: str, channels: int) -> list[SynapseRow]:
        """Target, with its slot, and weight of each synapse of each channel of a source."""
        found: list[dict[int, int]] = [{} for _ in range(channels)]
        for layer in self.plan.layers:
            for synapses, each in zip(layer.layer.synapses, layer.inputs, strict=True):
                base = (each.lag << self.neuron_bits) + self.first[layer.layer.name]
                if synapses.source != source:
                    continue
                for channel, neuron in np.argwhere(each.weight).tolist():
                    row, target = found[channel], base + neuron
                    row[target] = row.get(target, 0) + int(each.weight[channel, neuron])
        return [tuple(sorted((t, weight) for t, weight in row.items() if weight)) for row in found]

    def _held_bits(self, *names: str) -> int:
        """Bits of what any of the registers passes on [state units]."""
        layers = self.plan.magnitudes
        return max(self._register_bits(layer, name) for layer in layers for name in names)

    def _register_bits(self, layer: str, name: str) -> int:
        """Bits of what a register passes on of a layer; two's complement has one number more."""
        register: Register = getattr(self._rules, name)
        most = self.plan.magnitudes[layer].held[name]
        lowest = register.overflow in ("wrap", "saturate") and most == 1 << (register.bits - 1)
        return register.bits if lowest else signed_bits(most)

    @cached_property
    def sum_bits(self) -> int:
        """Bits of a sum of weights [units of the layer]."""
        units = {layer.layer.name: layer.unit for layer in self.plan.layers}
        each = self.plan.magnitudes.items()
        return signed_bits(max(most.arriving // units[name] for name, most in each))

    @cached_property
    def drive_bits(self) -> int:
        """Bits of a sum of weights [state units]."""
        shift = self._rules.mantissa_shift
        return signed_bits(max(m.arriving << shift for m in self.plan.magnitudes.values()))

    @property
    def _rules(self) -> CubaFixedPoint:
        """The arithmetic of the chip."""
        rules = self.plan.rules
        if not isinstance(rules, CubaFixedPoint):
            raise TypeError(type(rules).__name__)
        return rules

    @cached_property
    def state_bits(self) -> int:
        """Bits of a current and of a membrane."""
        return self._held_bits("current", "membrane")

    def membrane_bits(self, layer: str) -> int:
        """Bits of a membrane of a layer."""
        return self._register_bits(layer, "membrane")

    @cached_property
    def value_bits(self) -> int:
        """Bits of what any of the registers passes on."""
        return self._held_bits(*_REGISTERS)

    @cached_property
    def adder_bits(self) -> int:
        """Bits of any sum in an update."""
        largest = signed_bits(max(m.states for m in self.plan.magnitudes.values()))
        return max(largest, self.value_bits)

    @property
    def rest_bits(self) -> int:
        """Bits of the timesteps that a neuron rests after a spike; 0 where there are none."""
        spikes = any(layer.spiking for layer in self.program.layers)
        return (self._rules.refractory - 1).bit_length() if spikes else 0

    @cached_property
    def fields(self) -> Mapping[str, NeuronField]:
        """Numbers of the neurons, by name, as they are stored."""
        per_layer: dict[str, list[int | None]] = {name: [] for name in _FIELDS}
        read = {output.layer for output in self.outputs}
        axon = self.axons
        for layer in self.plan.layers:
            each = self._fields_of(layer, layer.layer.name in read, axon)
            for name, values in each.items():
                per_layer[name] += values
            axon += layer.size
        keeps_all = any(
            value == 1 << self.decay_bits
            for name in ("CURRENT_DECAY", "MEMBRANE_DECAY")
            for value in per_layer[name]
        )
        bits = {
            "CURRENT_DECAY": self.decay_bits + keeps_all,
            "MEMBRANE_DECAY": self.decay_bits + keeps_all,
            "VOLTAGE_BIAS": signed_bits(max(abs(v or 0) for v in per_layer["VOLTAGE_BIAS"])),
            "THRESHOLD": unsigned_bits(max(v or 0 for v in per_layer["THRESHOLD"])),
            "BIAS": self.sum_bits,
            "ROW": self.rows.entry_bits,
        }
        found, at = {}, self.layer_bits
        for name, values in per_layer.items():
            field = self._place(NeuronField(bits.get(name, 1), tuple(values)), at)
            found[name] = field
            at += field.bits * (field.at >= 0)
        return found

    def _fields_of(
        self, layer: LayerPlan, is_read: bool, axon: int
    ) -> Mapping[str, Sequence[int | None]]:
        """Numbers of the neurons of a layer by name; axon: of its first neuron."""
        held, size, spiking = layer.layer, layer.size, layer.layer.spiking
        ends = [k == size - 1 or k % 32 == 31 for k in range(size)]
        return {
            "CURRENT_DECAY": held.current_decay.tolist(),
            "MEMBRANE_DECAY": held.membrane_decay.tolist(),
            "VOLTAGE_BIAS": held.voltage_bias.tolist(),
            "THRESHOLD": held.threshold.tolist() if spiking else [None] * size,
            "BIAS": layer.bias.tolist(),
            "ROW": [self.rows.entry(axon + k) if spiking else None for k in range(size)],
            "SPIKING": [int(spiking)] * size,
            "HEARD": [int(is_read)] * size,
            "CLOSING": [int(end) for end in ends] if spiking and is_read else [None] * size,
        }

    def _place(self, field: NeuronField, at: int) -> NeuronField:
        """The field as it is stored: of each layer, or in parameters of the neurons."""
        of_layer: list[int] = []
        known = [value for value in field.values if value is not None]
        for layer in self.program.layers:
            first = self.first[layer.name]
            own = {v for v in field.values[first : first + layer.size] if v is not None}
            if len(own) > 1:
                return NeuronField(field.bits, field.values, at)
            of_layer += own or {known[0] if known else 0}
        return NeuronField(field.bits, field.values, -1, tuple(of_layer))

    @property
    def layer_bits(self) -> int:
        """Bits of the number of a layer."""
        return unsigned_bits(len(self.program.layers) - 1)

    @property
    def decay_bits(self) -> int:
        """A decay is a fraction of 2**this."""
        return self._rules.decay_bits

    @cached_property
    def neuron_word_bits(self) -> int:
        """Bits of the parameters of a neuron."""
        own = sum(each.bits for each in self.fields.values() if each.at >= 0)
        return self.layer_bits + own

    @cached_property
    def neuron_words(self) -> tuple[int, ...]:
        """Parameters of each neuron."""
        words, neuron = [], 0
        for k, layer in enumerate(self.program.layers):
            for _ in range(layer.size):
                word = k
                for each in self.fields.values():
                    if each.at >= 0:
                        value = (each.values[neuron] or 0) & ((1 << each.bits) - 1)
                        word |= value << each.at
                words.append(word)
                neuron += 1
        return tuple(words)

    @property
    def axon_words(self) -> tuple[int, ...]:
        """{negate, first synapse} of each channel of the input."""
        return tuple(map(self.rows.entry, range(self.axons)))

    @cached_property
    def registers(self) -> Mapping[str, Register]:
        """Registers by name; of overflow "none" where no number that can occur changes."""
        found = {name: getattr(self._rules, name) for name in _REGISTERS}
        return {
            name: register if name in self.plan.held else Register(register.bits, "none")
            for name, register in found.items()
        }

    @cached_property
    def localparams(self) -> Mapping[str, int | tuple[int, int]]:
        """Parameters of the core by name; a pair is a number, and the bits of its vector."""
        rows, slot_bits = self.rows, unsigned_bits(self.slots - 1)
        found: dict[str, int | tuple[int, int]] = {
            "AXONS": self.axons,
            "AXON_COUNT": (self.axons, 16),
            "AXON_BITS": unsigned_bits(self.axons - 1),
            "NEURONS": self.neurons,
            "NEURON_BITS": self.neuron_bits,
            "LAST_NEURON": (self.neurons - 1, self.neuron_bits),
            "LAYERS": len(self.program.layers),
            "LAYER_BITS": self.layer_bits,
            "NEURON_WORD_BITS": self.neuron_word_bits,
            "SLOT_BITS": slot_bits,
            "SLOT_MASK": (self.slots - 1, slot_bits),
            "SUMS": self.slots << self.neuron_bits,
            "SYNAPSES": len(rows.words),
            "SYNAPSE_ADDRESS_BITS": rows.address_bits,
            "SYNAPSE_BITS": rows.bits,
            "GAP_BITS": rows.gap_bits,
            "WEIGHT_BITS": rows.weight_bits,
            "FIRST_OF_INPUT": (rows.first[0], self.target_bits),
            "FIRST_OF_NEURONS": (rows.first[1], self.target_bits),
            "ROW_BITS": rows.entry_bits,
            "SUM_BITS": self.sum_bits,
            "DRIVE_BITS": self.drive_bits,
            "STATE_BITS": self.state_bits,
            "VALUE_BITS": self.value_bits,
            "ADDER_BITS": self.adder_bits,
            "DECAY_BITS": self.decay_bits,
            "COUNT_BITS": unsigned_bits(self.decay_bits - 1),
            "LAST_BIT": (self.decay_bits - 1, unsigned_bits(self.decay_bits - 1)),
            "DECAY_FIELD": self.fields["CURRENT_DECAY"].bits,
            "VOLTAGE_BIAS_FIELD": self.fields["VOLTAGE_BIAS"].bits,
            "THRESHOLD_FIELD": self.fields["THRESHOLD"].bits,
            "RESTS": (self._rules.refractory - 1, max(1, self.rest_bits)),
            "REST_BITS": self.rest_bits,
            "STATE_WORD_BITS": self.state_bits + self.rest_bits,
            "RESET_SUBTRACTS": int(self.program.convention.reset == "subtract"),
            "HEARS_SPIKES": int(any(not output.silent for output in self.outputs)),
            "LAST_HEARD": (self.last_heard, self.neuron_bits),
        }
        for name, register in self.registers.items():
            reached = max(m.registers[name] for m in self.plan.magnitudes.values())
            low, high = register.between or (0, 0)
            low, high = max(low, -reached), min(high, reached)
            found |= {
                f"{name.upper()}_KIND": _KINDS[register.overflow],
                f"{name.upper()}_BITS": register.bits,
                f"{name.upper()}_RANGED": int(register.between is not None),
                f"{name.upper()}_LOW": (low, 64),
                f"{name.upper()}_HIGH": (high, 64),
            }
        shifts = [
            (layer.unit.bit_length() - 1) + self._rules.mantissa_shift for layer in self.plan.layers
        ]
        found["SHIFT_OF"] = _packed(shifts, 8)
        none = [0] * len(self.program.layers)
        for name, each in self.fields.items():
            found[f"{name}_AT"] = each.at
            found[f"{name}_OF"] = _packed(each.of_layer or none, each.bits)
        return found


_REGISTERS = ("accumulator", "current", "push", "membrane")
_FIELDS = (
    "CURRENT_DECAY",
    "MEMBRANE_DECAY",
    "VOLTAGE_BIAS",
    "THRESHOLD",
    "BIAS",
    "ROW",
    "SPIKING",
    "HEARD",
    "CLOSING",
)


def core_image(program: Program, codec: Codec | None = None) -> CoreImage:
    """The image of a program; ConfigError where the core cannot compute it.

    codec: says how many timesteps an inference has, which bounds states that are reset.
    """
    check_program(program)
    program = program.dense("the core of an FPGA")
    image = CoreImage(Plan(program, codec))
    membrane_layers = [output.layer for output in image.outputs if output.silent]
    check_membranes({layer: image.membrane_bits(layer) for layer in membrane_layers})
    _ = image.localparams, image.neuron_words  # what cannot be is refused here, and not later
    return image


def _packed(values: Iterable[int], bits: int) -> tuple[int, int]:
    """A vector of numbers of so many bits, the first in the lowest; and its bits."""
    word, at = 0, 0
    for value in values:
        word |= (value & ((1 << bits) - 1)) << at
        at += bits
    return word, at


def _store_rows(
    inputs: Sequence[SynapseRow], neurons: Sequence[SynapseRow], target_bits: int
) -> Rows:
    """Rows of the input's channels and of neurons as words; equal ones, and negatives, once."""
    every = [*inputs, *neurons]
    weights = [weight for row in every for _, weight in row]
    weight_bits = signed_bits(max([1, *weights, *(~weight for weight in weights)]))
    gap_bits = min(target_bits, _WORD - 1 - weight_bits)
    if gap_bits < _NARROWEST_GAP:
        gap_bits = target_bits
    first = _first(inputs), _first(neurons)
    words: list[int] = []
    known: dict[SynapseRow, int] = {}
    starts: list[tuple[int, bool]] = []
    for axon, row in enumerate(every):
        start = first[axon >= len(inputs)]
        # from its start, with which rows of both kinds can be the same
        key = tuple((target - start, weight) for target, weight in row)
        opposite = tuple((gap, -weight) for gap, weight in key)
        if key in known or opposite in known:
            starts.append((known.get(key, known.get(opposite, 0)), key not in known))
            continue
        known[key] = len(words)
        starts.append((len(words), False))
        synapses = _with_gaps(key, (1 << gap_bits) - 1)
        for k, (gap, weight) in enumerate(synapses):
            last = k == len(synapses) - 1
            word = (last << gap_bits | gap) << weight_bits
            words.append(word | weight & ((1 << weight_bits) - 1))
    return Rows(tuple(words), gap_bits, weight_bits, tuple(starts), first)


def _first(rows: Iterable[SynapseRow]) -> int:
    """The least target of the rows."""
    return min((row[0][0] for row in rows if row), default=0)


def _with_gaps(row: SynapseRow, most: int) -> SynapseRow:
    """Return distance to the previous synapse and weight of each; fillers where it is too wide."""
    found, at = [], 0
    for target, weight in row:
        while target - at > most:
            found.append((most, 0))
            at += most
        found.append((target - at, weight))
        at = target
    return tuple(found) or ((0, 0),)
