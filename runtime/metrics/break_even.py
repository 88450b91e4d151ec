"""Below which spike rate, or how many operations, a spiking network costs less than a float one.

Both by the same table, which has prices for synaptic operations and multiply-accumulates. Yan et
al. (arXiv 2409.08290, version 4) have a model of their own, with data movement, and find 5.7 % at
T = 5 under what they call typical neuromorphic hardware conditions, against a network of 3 bits.
"""

from collections.abc import Mapping

from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.metrics.energy_tables import TABLES, EnergyTable

YAN2024 = 0.057  # spikes per neuron and timestep at T = 5

# with a price for both kinds of operations
BREAK_EVEN_TABLES = tuple(n for n, t in TABLES.items() if {"sop", "mac"} <= t.joules.keys())


def break_even_rate(
    table: EnergyTable, timesteps: int, fan_in: float | None = None, activity: float = 1.0
) -> float:
    """Spikes per presynaptic neuron and timestep below which spiking costs less.

    Of two networks of one shape; a rate of 0 or less is never reached, one above 1 always.

    timesteps: of the spiking network, T.
    fan_in: synapses of a neuron, each of which shares its updates; None leaves updates out.
    activity: share of the float network's inputs that are not 0, if it skips those; 1 is dense.

    Raises ConfigError where the table lacks a price.
    """
    if table.name not in BREAK_EVEN_TABLES:
        raise ConfigError(
            f"energy table {table.name!r} has no price for both synaptic operations and "
            f"multiply-accumulates. Choose one of {', '.join(BREAK_EVEN_TABLES)}."
        )
    prices = table.joules
    update = 0.0 if fan_in is None else prices["neuron_update"] / fan_in
    # per synapse and inference: T (rate sop + update / fan_in) = activity mac
    return (activity * prices["mac"] / timesteps - update) / prices["sop"]


def break_even_sops(
    terms: Mapping[str, float], sops: float, total: float, table: EnergyTable
) -> float:
    """Synaptic operations of an inference at which a spiking policy would cost `total` [J].

    Everything else of it stays as it is; below 0 where that alone costs more.

    terms: of the policy [J], as in energy_terms.
    sops: of it; where some multiply, the mean price stays.
    """
    operations = terms["operations"]
    price = operations / sops if sops and operations else table.joules["sop"]
    return (total - (sum(terms.values()) - operations)) / price
