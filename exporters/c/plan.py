"""What of a program its C has to know: names, types, which spikes are kept for how long."""

from dataclasses import dataclass
from functools import cached_property

from spikedeploy.exporters.c import magnitudes
from spikedeploy.exporters.c.declarations import bytes_of, narrowest
from spikedeploy.runtime.chips.layer import Layer
from spikedeploy.runtime.codec.codec import Codec
from spikedeploy.runtime.codec.delta import DeltaEncoder
from spikedeploy.runtime.compiler.program import Program, ReadoutTerm
from spikedeploy.runtime.families.cuba.fixed_point import CubaFixedPoint
from spikedeploy.runtime.families.cuba.neurons import CubaRegisters
from spikedeploy.runtime.families.integrate_and_fire.arithmetic import IntegrateAndFire


@dataclass(frozen=True, eq=False)
class Plan:
    """A program and its codec, with the answers that several files of C need.

    codec: None where the chip's part alone is written.
    """

    program: Program
    codec: Codec | None

    @cached_property
    def names(self) -> dict[str, str]:
        """The name in C of the input and of each layer."""
        layers = {layer.name: f"l{k}" for k, layer in enumerate(self.program.layers)}
        return {self.program.input: "in", **layers}

    @cached_property
    def sizes(self) -> dict[str, int]:
        """Channels of the input, neurons of each layer."""
        layers = {layer.name: layer.size for layer in self.program.layers}
        return {self.program.input: self.program.width, **layers}

    @cached_property
    def times_max(self) -> dict[str, int]:
        """Spikes of a neuron in a timestep, of the input and each layer."""
        chip = self.program.chip
        layers = dict.fromkeys((layer.name for layer in self.program.layers), chip.spikes_max)
        return {self.program.input: chip.input_spikes_max if not self.codec else 1, **layers}

    def several(self, source: str) -> bool:
        """Whether a neuron of a source can spike several times in a timestep."""
        return self.times_max[source] > 1

    @property
    def events_max(self) -> int:
        """Input channels that can spike in one timestep."""
        encoder = self.codec.encoder if self.codec else None
        if isinstance(encoder, DeltaEncoder):
            each = encoder.most if encoder.code == "unary" else 1
            return each * encoder.observed
        return self.program.width

    @cached_property
    def slots(self) -> dict[str, int]:
        """Timesteps of which the spikes are kept: as late as they are read, and the present."""
        latest = dict.fromkeys(self.names, 0)
        for layer, lags in zip(self.program.layers, self.program.lags, strict=True):
            for synapses, lag in zip(layer.synapses, lags, strict=True):
                latest[synapses.source] = max(latest[synapses.source], lag)
        for term in self.terms:
            if term.layer == self.program.input or self.program.layer(term.layer).spiking:
                latest[term.layer] = max(latest[term.layer], term.lag)
        return {name: lag + 1 for name, lag in latest.items()}

    @property
    def terms(self) -> tuple[ReadoutTerm, ...]:
        """All that the host receives, of one Output after another."""
        program = self.program
        if program.outlets:
            return tuple(tap for outlet in program.outlets for tap in outlet.taps)
        readout = program.readout
        weight, lag = (None, 0) if readout is None else (readout.weight, readout.lag)
        return (ReadoutTerm(program.output, weight, lag),)

    def slot(self, name: str, lag: int = 0) -> str:
        """C for the index of the spikes of a source some timesteps ago."""
        slots, of = self.slots[name], self.names[name]
        if slots == 1:
            return "0"
        return f"({of}_head + {slots - lag}u) % {slots}u" if lag else f"{of}_head"

    @cached_property
    def kind(self) -> str:
        """The C type of all states and sums."""
        kinds = [self._magnitudes(layer).kind for layer in self.program.layers]
        return max(kinds, key=bytes_of)

    @property
    def id_kind(self) -> str:
        """The C type of the number of a channel or neuron."""
        return narrowest(0, max(self.sizes.values()) - 1)

    def count_kind(self, name: str) -> str:
        """The C type of the number of a source's channels that spike."""
        return narrowest(0, self.capacity(name))

    def capacity(self, name: str) -> int:
        """Channels or neurons of a source that can spike in one timestep."""
        return self.events_max if name == self.program.input else self.sizes[name]

    @property
    def largest(self) -> int:
        """Largest magnitude of a state of any layer [state units]."""
        return max(self.states_max(layer.name) for layer in self.program.layers)

    def states_max(self, name: str) -> int:
        """Largest magnitude of a state of a layer, whatever the spikes [state units]."""
        return self._magnitudes(self.program.layer(name)).states

    def cuba_largest(self, layer: Layer, registers: CubaRegisters) -> magnitudes.CubaLargest:
        """Largest magnitudes that reach the registers of a layer."""
        weights = magnitudes.arriving(layer, self.times_max)
        return magnitudes.cuba_largest(layer, registers, weights, self._window)

    def _magnitudes(self, layer: Layer) -> magnitudes.Magnitudes:
        arithmetic = self.program.chip.arithmetic
        weights = magnitudes.arriving(layer, self.times_max)
        if isinstance(arithmetic, IntegrateAndFire):
            return magnitudes.of_integrate(layer, arithmetic, weights)
        if not isinstance(arithmetic, CubaFixedPoint):
            raise TypeError(type(arithmetic).__name__)
        return magnitudes.of_cuba(layer, arithmetic, weights, self._window)

    @property
    def _window(self) -> int | None:
        """Timesteps after which all states are reset; None where they are kept."""
        reset = self.program.convention.state == "reset" and self.codec is not None
        return self.codec.timesteps if self.codec is not None and reset else None
