"""The core of the Verilog export in Python: the same memories, clock for clock; no simulator.

It reads the words of the memories and the parameters, as policy_core.v does, and nothing else of
the program: what it computes is what the hardware is asked to compute.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

from spikedeploy.exporters.verilog.image import CoreImage

_NONE, _WRAP, _WRAP_ONCE, _CLIP = range(4)


@dataclass(frozen=True)
class ModelStep:
    """A timestep of the model.

    clocks: from its first token until another one could be taken.
    words: that leave, 32 bits each.
    last: whether each is the last of the timestep.
    current, membrane: (N,) of all neurons [state units].
    spikes: (N,) 0 or 1.
    """

    clocks: int
    words: Sequence[int]
    last: Sequence[bool]
    current: Sequence[int]
    membrane: Sequence[int]
    spikes: Sequence[int]


@dataclass
class _Found:
    """What has come of a timestep so far."""

    words: list[int] = field(default_factory=list)
    last: list[bool] = field(default_factory=list)
    current: list[int] = field(default_factory=list)
    membrane: list[int] = field(default_factory=list)
    spikes: list[int] = field(default_factory=list)


class CoreModel:
    """A core with the memories of an image.

    dsp: whether a decay takes one clock, in a multiplier, as with USE_DSP.
    sums: by slot and neuron [units of the layer].
    currents, membranes: of all neurons [state units].
    rests: timesteps that each neuron rests.
    """

    def __init__(self, image: CoreImage, dsp: bool = False) -> None:
        self._dsp = dsp
        self._parameters = image.localparams
        self._axons, self._synapses = image.axon_words, image.rows.words
        self._neurons = image.neuron_words
        self.reset()

    def reset(self) -> None:
        """Forget every state and spike."""
        neurons = self["NEURONS"]
        bias = [self._signed_field("BIAS", k, self["SUM_BITS"]) for k in range(neurons)]
        # fillers of a row can point behind the last neuron
        bias += [0] * ((1 << self["NEURON_BITS"]) - neurons)
        self.sums = [list(bias) for _ in range(self["SLOT_MASK"] + 1)]
        self.currents, self.membranes = [0] * neurons, [0] * neurons
        self.rests = [0] * neurons
        self._slot = self._clocks = 0

    @property
    def clear_clocks(self) -> int:
        """Clocks that a reset takes."""
        return 2 * self["NEURONS"] * (self["SLOT_MASK"] + 1)

    def step(self, tokens: Iterable[int]) -> ModelStep:
        """Compute a timestep with these tokens of input axons."""
        for token in tokens:
            self._clocks += 1
            if token < self["AXONS"]:
                self._clocks += 1
                self._deliver(self._axons[token], self["FIRST_OF_INPUT"])
        self._clocks += 1
        found = _Found()
        place, pending = 0, 0
        for neuron in range(self["NEURONS"]):
            self._update(neuron, found)
            spiked = found.spikes[-1]
            if self._field("HEARD", neuron, 1):
                if not self._field("SPIKING", neuron, 1):
                    self._emit(found, found.membrane[-1], neuron)
                else:
                    pending |= spiked << place
                    place += 1
                    if self._field("CLOSING", neuron, 1):
                        self._clocks += 32 - place
                        self._emit(found, pending, neuron)
                        place = pending = 0
            if spiked:
                row = self._field("ROW", neuron, self["ROW_BITS"])
                self._deliver(row, self["FIRST_OF_NEURONS"])
        self._slot = (self._slot + 1) & self["SLOT_MASK"]
        clocks, self._clocks = self._clocks, 0
        return ModelStep(clocks, **vars(found))

    def _update(self, neuron: int, found: _Found) -> None:
        """Advance a neuron by one timestep."""
        shift = self._of_layer("SHIFT_OF", neuron, 8)
        drive = self._fit("ACCUMULATOR", self.sums[self._slot][neuron] << shift)
        current = self._fit("CURRENT", self._decay("CURRENT", neuron, self.currents) + drive)
        bits = self["VOLTAGE_BIAS_FIELD"]
        push = self._fit("PUSH", current + self._signed_field("VOLTAGE_BIAS", neuron, bits))
        kept = self._decay("MEMBRANE", neuron, self.membranes)
        membrane = self._fit("MEMBRANE", kept + push)
        spiked = False
        self._clocks += 4  # ADD, PUSH, ADD, STORE
        if self._field("SPIKING", neuron, 1):
            self._clocks += 1  # FIRE
            threshold = self._field("THRESHOLD", neuron, self["THRESHOLD_FIELD"])
            resting = self.rests[neuron] > 0
            spiked = membrane > threshold and not resting
            if spiked and self["RESET_SUBTRACTS"]:
                self._clocks += 1
                membrane -= threshold
            elif spiked or resting:
                membrane = 0
            rest = self["RESTS"] if spiked else max(self.rests[neuron] - 1, 0)
            self.rests[neuron] = rest
        self.sums[self._slot][neuron] = self._signed_field("BIAS", neuron, self["SUM_BITS"])
        self.currents[neuron], self.membranes[neuron] = current, membrane
        found.current.append(current)
        found.membrane.append(membrane)
        found.spikes.append(int(spiked))

    def _decay(self, name: str, neuron: int, states: Sequence[int]) -> int:
        """What is left of a state, rounded toward zero."""
        bits, state = self["DECAY_BITS"], states[neuron]
        factor = self._field(f"{name}_DECAY", neuron, self["DECAY_FIELD"])
        at_once = self._dsp or factor in (0, 1 << bits)
        self._clocks += 1 + (1 if at_once else bits)  # READ, DECAY
        left = abs(state) * factor >> bits
        return left if state >= 0 else -left

    def _deliver(self, row: int, target: int) -> None:
        """Add a row of synapses to the accumulators; target: from which its first gap counts."""
        address_bits, weight_bits = self["SYNAPSE_ADDRESS_BITS"], self["WEIGHT_BITS"]
        negated, address = row >> address_bits, row & ((1 << address_bits) - 1)
        neuron_bits = self["NEURON_BITS"]
        last = False
        self._clocks += 2  # FIRST, FLUSH
        while not last:
            word = self._synapses[address]
            weight = _signed(word, weight_bits)
            gap = word >> weight_bits & ((1 << self["GAP_BITS"]) - 1)
            last = bool(word >> (weight_bits + self["GAP_BITS"]))
            target += gap
            slot = (self._slot + (target >> neuron_bits)) & self["SLOT_MASK"]
            neuron = target & ((1 << neuron_bits) - 1)
            self.sums[slot][neuron] += -weight if negated else weight
            address += 1
            self._clocks += 1

    def _emit(self, found: _Found, word: int, neuron: int) -> None:
        """Send a word."""
        self._clocks += 1
        found.words.append(word & 0xFFFFFFFF)
        found.last.append(neuron == self["LAST_HEARD"])

    def _fit(self, name: str, number: int) -> int:
        """A number as a register holds it."""
        kind, half = self[f"{name}_KIND"], 1 << (self[f"{name}_BITS"] - 1)
        if kind == _WRAP:
            number = (number + half) % (2 * half) - half
        elif kind == _WRAP_ONCE:
            number += -2 * half if number > half else 2 * half if number <= -half else 0
        elif kind != _NONE:
            number = min(max(number, 1 - half if kind == _CLIP else -half), half - 1)
        if not self[f"{name}_RANGED"]:
            return number
        low, high = (_signed(self[f"{name}_{end}"], 64) for end in ("LOW", "HIGH"))
        return min(max(number, low), high)

    def __getitem__(self, name: str) -> int:
        """A parameter."""
        value = self._parameters[name]
        return value[0] if isinstance(value, tuple) else value

    def _of_layer(self, name: str, neuron: int, bits: int) -> int:
        """A number of the neuron's layer."""
        layer = self._neurons[neuron] & ((1 << self["LAYER_BITS"]) - 1)
        return self[name] >> (layer * bits) & ((1 << bits) - 1)

    def _field(self, name: str, neuron: int, bits: int) -> int:
        """A number of the neuron, or of its layer."""
        at = self[f"{name}_AT"]
        if at < 0:
            return self._of_layer(f"{name}_OF", neuron, bits)
        return self._neurons[neuron] >> at & ((1 << bits) - 1)

    def _signed_field(self, name: str, neuron: int, bits: int) -> int:
        return _signed(self._field(name, neuron, bits), bits)


def _signed(word: int, bits: int) -> int:
    """The lowest bits of a word as a signed number."""
    number = word & ((1 << bits) - 1)
    return number - (1 << bits) if number >> (bits - 1) else number
