"""How much a replay computes, summed up layer by layer before anything of it is allocated."""

from dataclasses import dataclass

from spikedeploy.runtime.traces.fields import Fields, Integers

# together about five seconds of one core and 500 MB
_MOST_TICKS = 1 << 15  # layers times timesteps
_MOST_STATES = 1 << 22  # neurons times timesteps
_MOST_NEURONS = 1 << 17
_MOST_PRODUCTS = 1 << 27  # synapses times timesteps
_MOST_ONE_BY_ONE = 1 << 17  # axons and aliases times timesteps, which are taken one by one
_MOST_SPIKES = 1 << 16  # of the input, each an event of its own
MOST_NUMBERS = 1 << 24  # membranes after each event of a crossbar


@dataclass
class Work:
    """What a replay of so many timesteps computes.

    spec: the fields, for messages.
    inference: timesteps of each of those that are computed side by side; 0 where there is one.
    """

    spec: Fields
    timesteps: int
    inference: int = 0
    layers: int = 0
    neurons: int = 0
    synapses: int = 0
    axons: int = 0

    def add(self, neurons: int, synapses: int, axons: int = 0) -> None:
        """Another layer; refused where the replay would take too long.

        axons: those whose events a chip adds one after another, and aliases.
        """
        self.layers += 1
        self.neurons, self.synapses = self.neurons + neurons, self.synapses + synapses
        self.axons += axons
        turns = self.inference or self.timesteps
        self._check("layers", self.layers * turns, _MOST_TICKS)
        self._check("neurons", self.neurons * self.timesteps, _MOST_STATES)
        self._check("neurons", self.neurons, _MOST_NEURONS, timesteps="")
        self._check("synapses", self.synapses * self.timesteps, _MOST_PRODUCTS)
        self._check("axons and aliases", self.axons * turns, _MOST_ONE_BY_ONE)

    def check_input(self, counts: Integers) -> None:
        """Refuse more input spikes (T, M) than are replayed one by one."""
        if (found := int(counts.sum())) > _MOST_SPIKES:
            remedy = f"Record {_MOST_SPIKES} spikes at most."
            raise self.spec.wrong("input_spikes", f"has {found} spikes", remedy)

    def _check(self, what: str, found: int, most: int, timesteps: str = " times timesteps") -> None:
        if found > most:
            remedy = f"At most {most} are replayed: record less, or in parts."
            raise self.spec.wrong("replay", f"has {found} {what}{timesteps}", remedy)
