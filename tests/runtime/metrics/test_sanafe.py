"""Events and energies against SANA-FE's simulation of random networks, where it is installed."""

import numpy as np
import pytest

from spikedeploy.runtime.metrics.energy import latency_estimate
from spikedeploy.runtime.metrics.energy_tables import TABLES
from tests.runtime.metrics.sanafe_networks import (
    NETWORKS,
    energy,
    one_core_each,
    program,
    run,
    scatter,
    simulate,
    traffic,
)

TABLE = TABLES["sanafe"]
UPDATE = TABLE.joules["neuron_update"] - TABLE.joules["neuron_idle"]
STEPS = 20


@pytest.fixture(autouse=True, scope="module")
def _sanafe():
    pytest.importorskip(
        "sanafe", reason="SANA-FE is not installed; ./spike test --peers compares with it"
    )


def raster_of(network, seed, rate):
    return (np.random.default_rng(seed).random((STEPS, network.width)) < rate).astype(np.uint8)


@pytest.mark.parametrize("mapping", ["one core each", "scattered"])
@pytest.mark.parametrize("rate", [0.05, 0.3])
@pytest.mark.parametrize("case", NETWORKS)
def test_the_energy_of_a_random_network_is_sanafes(case, rate, mapping):
    network = program(case, seed=1)
    raster = raster_of(network, 2, rate)
    layout = one_core_each(network) if mapping == "one core each" else scatter(network, 3)
    ledger, spikes = run(network, raster)
    sent = traffic(network, spikes, layout)
    theirs = simulate(network, raster, layout)
    inputs = int(raster.sum())
    assert ledger.total("sop") == theirs["spikes"] > 0
    assert ledger.total("spike_out") == theirs["neurons_fired"] - inputs
    assert sent.message == theirs["packets_sent"]
    assert sent.hop_x + sent.hop_y == sum(theirs["perf_trace"]["hops"])
    # neurons whose inputs cancel are updated there, and those with a current left are updated here
    more = ledger.total("neuron_update") - (theirs["neurons_updated"] - inputs)
    assert abs(more) <= 0.01 * ledger.total("neuron_update")
    ours = energy(ledger, sent)
    assert ours - more * UPDATE == pytest.approx(theirs["energy"]["total"], rel=1e-9)
    assert ours == pytest.approx(theirs["energy"]["total"], rel=2e-3)


@pytest.mark.parametrize("case", NETWORKS)
def test_the_time_of_layers_on_one_tile_is_an_upper_bound_of_sanafes(case):
    network = program(case, seed=6)
    raster = raster_of(network, 7, 0.2)
    ledger, _ = run(network, raster)
    theirs = simulate(network, raster, one_core_each(network))
    assert 1.0 < latency_estimate(ledger, TABLE).value / theirs["sim_time"] < 4.0
