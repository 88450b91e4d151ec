"""Which networks run on which chip, and by which rule the others are refused."""

import nir
import numpy as np
import pytest

from spikedeploy.runtime.artifact.artifact import Artifact
from spikedeploy.runtime.chips.chip import CHIPS, chip
from spikedeploy.runtime.compiler.compile import compile_program
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.emulator.interpreter import trace
from spikedeploy.runtime.errors import RuleError
from spikedeploy.runtime.float_model import FloatGraph
from tests.networks import chain, cuba, lif

LOIHI = ("loihi1", "loihi1-brian2", "loihi1-nengo", "loihi2")
CURRENTLESS = ("speck2f", "truenorth", "odin", "spiker")


def integrators(size):
    """Neurons without leak that a few spikes bring to their threshold."""
    return nir.IF(np.full(size, 1000.0), np.full(size, 2.0))


def leaky(size):
    return lif(size, tau=0.004, r=4.0, threshold=2.0)


def synaptic(size):
    return cuba(size, alpha=0.5, beta=0.75, threshold=2.0)


def network(neurons, values=(-1.0, 1.0), reset="zero", signed=False):
    """Eight inputs, six neurons, four neurons, of weights that are among a few values."""
    rng = np.random.default_rng(5)
    first, second = (rng.choice(values, size) for size in ((6, 8), (4, 6)))
    if signed:
        # every third axon inhibits
        first, second = (np.where(np.arange(w.shape[1]) % 3 == 2, -w, w) for w in (first, second))
    nodes = [nir.Linear(first), neurons(6), nir.Linear(second), neurons(4)]
    return Artifact(chain(*nodes, width=8, act=4), None, Convention(1e-3, reset))


def signed(reset="zero", neurons=integrators):
    """Synapses of one size, there or not, with the signs of their axons."""
    return network(neurons, (0.0, 1.0), reset, signed=True)


NETWORKS = {
    "integrators of +-1": lambda reset: network(integrators, reset=reset),
    "signed axons": signed,
    "many weights": lambda reset: network(integrators, np.linspace(-1, 1, 40), reset=reset),
    "leaky": lambda reset: signed(reset, leaky),
    "synaptic currents": lambda reset: signed(reset, synaptic),
}
# chip -> network -> the rule that refuses it; everything else runs
REFUSED = {
    **{name: {} for name in ("ideal", "int", "spinnaker2", "spinnaker2-lif", *LOIHI)},
    "speck2f": {"leaky": "decay-range", "synaptic currents": "primitive"},
    "truenorth": {
        # two axons that reach two neurons with (1, -1) and (-1, 1) are of two types, and so on
        "integrators of +-1": "axon-types",
        "many weights": "axon-types",
        "leaky": "decay-range",
        "synaptic currents": "primitive",
    },
    "odin": {
        "integrators of +-1": "sign",
        "many weights": "sign",
        "leaky": "decay-range",
        "synaptic currents": "primitive",
    },
    "spiker": {
        "integrators of +-1": "decay-range",
        "signed axons": "decay-range",
        "many weights": "decay-range",
        "synaptic currents": "primitive",
    },
}
# what stays refused without limits: no arithmetic of the chip is near it
NEVER = {"primitive": CURRENTLESS, "decay-range": ("speck2f",)}
KNOWN = [name for name in CHIPS if name in REFUSED]


def reset_of(name):
    return chip(name).resets[0]


def raster(copies=3):
    return (np.random.default_rng(1).random((copies, 25, 8)) < 0.5).astype(np.uint8)


@pytest.mark.parametrize("name", KNOWN)
@pytest.mark.parametrize("kind", NETWORKS)
def test_a_network_runs_or_the_rule_is_named(name, kind):
    artifact = NETWORKS[kind](reset_of(name))
    rule = REFUSED[name].get(kind)
    if rule:
        with pytest.raises(RuleError, match=f"^rule {rule}: .*{name}"):
            compile_program(artifact, chip(name))
    else:
        assert trace(compile_program(artifact, chip(name)), raster())["n4"].spikes.any()


@pytest.mark.parametrize("name", KNOWN)
@pytest.mark.parametrize("kind", NETWORKS)
def test_without_limits_all_runs_that_the_arithmetic_has_something_for(name, kind):
    artifact = NETWORKS[kind](reset_of(name))
    if name in NEVER.get(REFUSED[name].get(kind), ()):
        with pytest.raises(RuleError, match=r"^rule "):
            compile_program(artifact, chip(name), limits=False)
    else:
        program = compile_program(artifact, chip(name), limits=False)
        assert trace(program, raster())["n2"].spikes.any()


@pytest.mark.parametrize("name", ["speck2f", "truenorth", "odin", "spiker", "spinnaker2", "int"])
def test_whole_weights_and_integrators_mean_what_they_mean_in_float(name):
    """Nothing is rounded on a chip that subtracts, nothing clipped, and no sum is the threshold."""
    reset = reset_of(name)
    rng = np.random.default_rng(2)
    nodes = [
        nir.Linear(rng.choice((0.0, 1.0), (6, 8))),
        nir.IF(np.full(6, 1000.0), np.full(6, 318 / 127)),
        nir.Linear(rng.choice((0.0, 1.0), (4, 6))),
        nir.IF(np.full(4, 1000.0), np.full(4, 1.5)),
    ]
    convention = Convention(1e-3, reset, spikes="many" if name == "speck2f" else "above")
    artifact = Artifact(chain(*nodes, width=8, act=4), None, convention)
    # one event in a timestep at most, so that it makes no difference whether odin looks at each
    spikes = np.zeros((1, 24, 8), np.uint8)
    spikes[0, np.arange(24), rng.integers(0, 8, 24)] = 1
    expected = FloatGraph(artifact).run(spikes)
    found = trace(compile_program(artifact, chip(name), limits=False), spikes)
    np.testing.assert_array_equal(found["n2"].spikes, expected["n2"])
    assert expected["n2"].any()
