"""Xylo's quantisers against rockpool's, which `./spike test --peers` installs without the rest.

Its file is loaded alone: the package has parts that install software when they are imported.
"""

from importlib.util import find_spec, module_from_spec, spec_from_file_location
from pathlib import Path

import numpy as np
import pytest

from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.chips.quantisation import Quantisation
from spikedeploy.runtime.compiler.compile import compile_program, float_program
from spikedeploy.runtime.compiler.lowering import lower
from spikedeploy.runtime.compiler.synapses import layer_graph
from tests.xylo_networks import network

HIDDEN = ("weights_in", "weights_rec", "threshold", "bias")
FIELDS = {
    "threshold": "threshold",
    "bias": "voltage_bias",
    "dash_mem": "membrane_decay",
    "dash_syn": "current_decay",
}
OUTPUT = ("weights_out", "threshold_out", "bias_out")


@pytest.fixture(scope="module")
def rockpool():
    """Its module of quantisers."""
    if (found := find_spec("rockpool")) is None:
        pytest.skip("rockpool is not installed; ./spike test --peers compares with it")
    file = Path(found.submodule_search_locations[0]) / "transform" / "quantize_methods.py"
    spec = spec_from_file_location("quantize_methods", file)
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def parameters(program):
    """The program's layers as one hidden population and the outputs."""
    *hidden, output = program.layers
    ends = np.cumsum([layer.size for layer in hidden])
    rows = {a.name: slice(e - a.size, e) for a, e in zip(hidden, ends, strict=True)}
    found = {
        "weights_in": np.zeros((program.width, ends[-1])),
        "weights_rec": np.zeros((ends[-1], ends[-1])),
        "weights_out": np.zeros((ends[-1], output.size)),
    }
    for layer in program.layers:
        for synapses in layer.synapses:
            if layer is output:
                found["weights_out"][rows[synapses.source]] = synapses.weight
            elif synapses.source == program.input:
                found["weights_in"][:, rows[layer.name]] = synapses.weight
            else:
                found["weights_rec"][rows[synapses.source], rows[layer.name]] = synapses.weight
    for name, field in FIELDS.items():
        found[name] = np.concatenate([np.ravel(getattr(layer, field)) for layer in hidden])
        found[f"{name}_out"] = np.ravel(getattr(output, field))
    return found


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("granularity", ["layer", "channel"])
@pytest.mark.parametrize("biased", [False, True])
def test_the_integers_are_rockpools(rockpool, granularity, biased, seed):
    rng = np.random.default_rng(seed)
    artifact = network(rng, [8, 10, 7, 4], ["cuba"] * 3, loops={1, 2}, biased=biased)
    program = compile_program(artifact, chip("xylo-a2"), quantisation=Quantisation(granularity))
    ours = parameters(program)
    wanted = quantised(rockpool, parameters(floats(artifact)), granularity)
    # the biases of outputs are where rockpool's global quantiser is wrong
    compared = {*HIDDEN, *OUTPUT} - ({"bias_out"} if granularity == "layer" else set())
    for name in compared:
        found = wanted[name][:, :, 0] if name in ("weights_in", "weights_rec") else wanted[name]
        np.testing.assert_array_equal(found, ours[name])


def floats(artifact):
    """The network as Xylo has it, before rounding."""
    chosen = chip("xylo-a2")
    return float_program(artifact, chosen, layer_graph(lower(artifact), artifact))


def quantised(rockpool, found, granularity):
    shaped = dict(found, dash_syn_2=0 * found["dash_syn"])
    for name in ("weights_in", "weights_rec"):
        # with one synapse a neuron, rockpool does not scale the biases of channels
        shaped[name] = np.stack([found[name], 0 * found[name]], axis=2)
    method = rockpool.global_quantize if granularity == "layer" else rockpool.channel_quantize
    return method(**shaped)
