"""The family of free widths: any of its chips runs fast, and means what its widths say."""

from itertools import pairwise

import nir
import numpy as np
import pytest

from spikedeploy.runtime.artifact.artifact import Artifact
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.chips.registers import Register
from spikedeploy.runtime.compiler.compile import compile_program
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.emulator.interpreter import trace
from spikedeploy.runtime.errors import ChipError
from tests.networks import chain, cuba


def network(seed=0, reset="zero", sizes=(30, 14, 6)):
    """Neurons whose thresholds a few bits can hold beside their weights."""
    rng = np.random.default_rng(seed)
    nodes = []
    for fan_in, size in pairwise(sizes):
        bias = rng.uniform(-1, 1, size)
        nodes += [nir.Affine(rng.uniform(-1, 2, (size, fan_in)), bias), cuba(size, threshold=3.0)]
    return Artifact(chain(*nodes, width=sizes[0], act=sizes[-1]), None, Convention(1e-3, reset))


@pytest.mark.parametrize(
    ("mode", "bits", "largest"), [("mixed", 2, 1), ("mixed", 16, 32767), ("split", 1, 1)]
)
def test_a_weight_uses_all_its_bits(mode, bits, largest):
    fixed = chip("int", sign_mode=mode, weight_bits=bits).arithmetic
    assert (fixed.weight_step, fixed.weight_max) == (1, largest)
    program = compile_program(network(), chip("int", sign_mode=mode, weight_bits=bits))
    assert np.abs(program.layers[0].synapses[0].weight).max() == largest


def test_by_hand():
    # weights 3 and -2 of 3 bits, half of the current and 3/4 of the membrane stay, threshold 5
    #
    # t   arrives   current              membrane
    # 0   3         3                    3
    # 1   3         1.5 -> 1 + 3 = 4     2.25 -> 2 + 4 = 6 > 5: spike, 6 - 5 = 1
    # 2   -2        2 - 2 = 0            0.75 -> 0
    # 3   -2        -2                   -2
    # 4   -         -1                   -1.5 -> -1 - 1 = -2
    neurons = nir.CubaLIF(
        *(np.full(1, v) for v in (2e-3, 4e-3, 4.0, 0.0, 5.0)), w_in=np.full(1, 2.0)
    )
    network = chain(nir.Linear(np.array([[3.0, -2.0]])), neurons, width=2, act=1)
    artifact = Artifact(network, None, Convention(1e-3, reset="subtract"))
    program = compile_program(artifact, chip("int:weight_bits=3,decay_bits=2,mantissa_shift=0"))
    raster = np.array([[[1, 0], [1, 0], [0, 1], [0, 1], [0, 0]]], np.uint8)
    found = trace(program, raster)["n2"]
    assert found.current.ravel().tolist() == [3, 4, 0, -2, -1]
    assert found.membrane.ravel().tolist() == [3, 1, 0, -2, -2]
    assert found.spikes.ravel().tolist() == [0, 1, 0, 0, 0]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"weight_bits": 1}, "weight_bits is 1; the chip stores one of 2, 3"),
        ({"weight_bits": 16, "sign_mode": "split"}, "weight_bits is 16; the chip stores"),
        ({"decay_bits": 17}, "decay_bits is 17; choose 1 to 16"),
        ({"membrane": 40}, "membrane has 40 bits; choose at most 36"),
        ({"membrane": 1}, "a register of 1 bits; choose 2 to 62"),
        ({"membrane": Register(24, "none")}, "membrane must end somewhere"),
        ({"membrane": 6, "mantissa_shift": 6}, "no threshold above 0 is left"),
        ({"threshold_max": 3}, "no option 'threshold_max'; did you mean 'threshold_bits'"),
    ],
)
def test_an_impossible_width_is_refused_with_its_limit(options, message):
    with pytest.raises(ChipError, match=message):
        chip("int", **options)
