"""A new family of chips is a class that answers for its numbers, a datasheet, and a line."""

import nir
import numpy as np
import pytest

from spikedeploy.reports.datasheets import chip_table
from spikedeploy.runtime.analysis.drift import drift
from spikedeploy.runtime.artifact.artifact import Artifact
from spikedeploy.runtime.chips import ARITHMETICS, CHIPS
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.chips.quantisation import Quantisation
from spikedeploy.runtime.compiler.compile import check, compile_program
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.emulator.machine import Machine
from spikedeploy.runtime.errors import ConfigError, RuleError
from spikedeploy.runtime.metrics.traffic import memory_traffic
from tests.networks import chain, lif
from tests.paths import ROOT


@pytest.fixture(autouse=True)
def line(monkeypatch):
    """The only lines that the package needs."""
    monkeypatch.setitem(ARITHMETICS, "leaky-six-bits", "tests.toy_family:LeakySixBits")
    monkeypatch.setitem(CHIPS, "toy", ROOT / "tests" / "toy.toml")


def network(size=3, reset="zero"):
    """Two layers; the largest weight, 1, becomes 7."""
    weight = np.tile([1.0, -1.0, 0.5], (size, 1))
    neurons = lif(size, tau=0.004, r=4.0, threshold=2.0)
    nodes = nir.Linear(weight), neurons, nir.Linear(2 * np.eye(size)), neurons
    return Artifact(chain(*nodes, width=3, act=size), None, Convention(1e-3, reset))


def ran(raster, **options):
    machine = Machine(
        compile_program(network(), chip("toy", **options)), backend="interpreter", trace=True
    )
    machine.infer(np.array([raster], np.uint8))
    return machine


def test_its_numbers_are_those_of_its_own_update():
    machine = ran([[1, 0, 0], [1, 0, 0], [1, 0, 0], [0, 1, 0]])
    first, second = machine.recordings.values()
    # V - (V >> 2) + 7 from zero, then less 7; above 14 it fires and is 0
    assert first.membrane[0, :, 0].tolist() == [7, 13, 0, -7]
    assert first.spikes[0, :, 0].tolist() == [0, 0, 1, 0]
    assert second.membrane[0, :, 0].tolist() == [0, 0, 7, 6]


def test_its_machine_is_the_interpreter_whatever_backend_is_asked_for():
    raster = np.ones((1, 5, 3), np.uint8)
    program = compile_program(network(), chip("toy"))
    outputs = [Machine(program, backend=name).infer(raster) for name in ("numpy", "auto")]
    for output in outputs:
        np.testing.assert_array_equal(output, Machine(program, backend="interpreter").infer(raster))
    with pytest.raises(ConfigError, match="supported by interpreter alone"):
        Machine(program, backend="numba")


def test_its_ledger_counts_what_it_did_and_what_overflowed():
    ledger = ran([[1, 0, 0], [1, 0, 0], [1, 0, 0], [0, 1, 0]]).ledger
    assert (ledger.total("spike_in"), ledger.total("spike_out")) == (4 + 3, 3)
    assert ledger.total("sop") == 4 * 3 + 3
    assert ledger.total("saturation") == 0
    # weights of 15 fill a membrane of 5 bits at once, and saturate it when they come again
    assert ran([[1, 0, 0]], weight_bits=5, membrane=5).ledger.total("saturation") == 0
    assert ran([[1, 0, 0]] * 2, weight_bits=5, membrane=5).ledger.total("saturation") == 3


def test_its_datasheet_has_a_row_beside_the_others():
    (row,) = chip_table([chip("toy")]).rows
    weights, membrane = "4 bits with the sign", "6 bits, saturates"
    assert row == (
        "toy",
        "LIF, leak by a shift",
        weights,
        membrane,
        "zero",
        "on the host",
        "gated, pipelined, free",
        "compared with nothing",
    )


def test_design_rules_judge_it_by_its_limits():
    assert check(network(), chip("toy")).passed
    (neurons,) = [r for r in check(network(9), chip("toy")).results_of("neurons") if r.node is None]
    assert (neurons.status, neurons.found, neurons.limit) == ("fail", 18, 8)


def test_what_it_does_not_have_is_refused_in_its_name():
    with pytest.raises(RuleError, match="a spike on toy can only do 'zero'"):
        compile_program(network(reset="subtract"), chip("toy"))
    with pytest.raises(ConfigError, match="on toy only rounding can be chosen"):
        compile_program(network(), chip("toy"), Quantisation(granularity="channel"))


def test_measures_and_analysis_take_it_as_they_take_any_chip():
    raster = np.zeros((2, 6, 3), np.uint8)
    raster[:, :, 0] = 1
    program = compile_program(network(), chip("toy"))
    machine = Machine(program, 2)
    machine.infer(raster)
    assert all(
        layer["weight_reads"] > 0 for layer in memory_traffic(machine.ledger, program).values()
    )
    found = drift(network(), chip("toy"), raster)
    assert [layer.neurons for layer in found.layers] == [3, 3]
    assert found.ablation == ()
