"""Where the energy of an inference goes: terms on the chip, and terms of the host beside it.

operations  synaptic operations, which multiply where a spike is graded; of a float network
            multiply-accumulates
bias        the always-on axon that carries the biases; of a float network the addition of each
updates     neurons with something to add up
idle        neurons that a chip only looks at
messages    packets between layers, and to the host
spikes      what neurons pay for sending one, where a table prices that apart
encoder     numbers to spikes; of a float network the reading of its observations
readout     weights and constants that the host applies to what leaves the chip
resets      states that are set to 0 between inferences
activations units of a float network that are written and read between its layers

What the host does (`encoder`, `readout`) has the same prices beside every table, as no table of a
chip has any for it: Horowitz 2014, ISSCC, 45 nm: 0.1 pJ a 32-bit integer addition, 3.1 pJ a
multiplication, 10 pJ an access of 64 bits of an 8 KB SRAM, of which 16 bits are a quarter. The
counts of these operations are derived, and the least that will do. The normalisation of
observations folds into thresholds and weights, and tanh or argmax is the same for all policies:
neither is counted.
"""

from collections.abc import Mapping

from spikedeploy.runtime.metrics.energy import marginal_prices
from spikedeploy.runtime.metrics.energy_tables import TABLES, EnergyTable

_PICO = 1e-12
ADDITION = 0.1 * _PICO  # 32-bit integers; a comparison is a subtraction
MULTIPLICATION = 3.1 * _PICO
ACCESS = 10 / 4 * _PICO  # 16 of 64 bits
INSTRUCTION = 70 * _PICO  # of a simple processor, its cache and registers included

_EVENTS = {
    "operations": ("sop", "graded_sop"),
    "bias": ("bias_sop",),
    "updates": ("neuron_update", "one_state_update"),
    "idle": ("neuron_idle",),
    "messages": ("message",),
    "spikes": ("spike_out",),
}
ON_CHIP = tuple(_EVENTS)
TERMS = (*ON_CHIP, "encoder", "readout", "resets", "activations")

_INT8 = TABLES["horowitz45-int8"].joules
_FETCHED_ADDITION = _INT8["sop"]
_FETCHED_MAC = _INT8["mac"]


def chip_terms(counts: Mapping[str, float], table: EnergyTable) -> dict[str, float]:
    """Energy [J] of each term of the chip, from the counts of its events; 0 without a price."""
    prices = marginal_prices(table.joules)
    return {
        term: sum(counts.get(event, 0.0) * prices.get(event, 0.0) for event in events)
        for term, events in _EVENTS.items()
    }


def priced_terms(counts: Mapping[str, float], table: EnergyTable) -> dict[str, float]:
    """The same without terms that are unknown, or part of another price."""
    left_out = (*unpriced(counts, table), *table.included)
    return {term: j for term, j in chip_terms(counts, table).items() if term not in left_out}


def unpriced(counts: Mapping[str, float], table: EnergyTable) -> tuple[str, ...]:
    """Terms of the chip that happened and have no price, neither their own nor within another."""
    return tuple(
        term
        for term, (event, *_) in _EVENTS.items()
        if counts.get(event, 0.0) > 0 and event not in table.joules and term not in table.included
    )


def reading(observations: float) -> float:
    """Energy [J] of reading so many observations once."""
    return observations * ACCESS


def delta_encoder(observations: float, events: float, timesteps: int = 1) -> float:
    """Energy [J] of a delta encoder in an inference.

    For each observation its reading; in each timestep a subtraction, a comparison and the read of
    its level; for each event an addition and the write of the level.

    observations: that some synapse reads.
    """
    observed = observations * timesteps * (2 * ADDITION + ACCESS)
    return reading(observations) + observed + events * (ADDITION + ACCESS)


def rate_encoder(observations: float, timesteps: int) -> float:
    """Energy [J] of a regular rate encoder in an inference.

    For each observation its reading, a multiplication and an addition that scale it to a rate; in
    each timestep an addition, and the accumulator read and written.
    """
    scaled = observations * (MULTIPLICATION + ADDITION)
    return reading(observations) + scaled + observations * timesteps * (ADDITION + 2 * ACCESS)


def added(constants: float) -> float:
    """Energy [J] of adding so many constants, each of them fetched."""
    return constants * _FETCHED_ADDITION


def host_readout(additions: float, products: float, constants: float) -> float:
    """Energy [J] of a readout that the host applies: weights added or multiplied, and constants."""
    return added(additions) + products * _FETCHED_MAC + added(constants)


def resets(states: float, table: EnergyTable) -> float | None:
    """Energy [J] of setting so many states to 0: a write each; None where nothing prices it.

    Derived where a table prices memory; what it takes on a chip is not published.
    """
    if not states:
        return 0.0
    return states * table.joules["state_write"] if "state_write" in table.joules else None
