"""What a spike does to the membrane, each reset worked out by hand."""

import nir
import numpy as np
import pytest

from spikedeploy.runtime.artifact.artifact import Artifact
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.float_model import FloatGraph
from tests.networks import chain, cuba, lif

HALVING = lif(1, tau=2e-3, r=2.0)  # V = 0.5 V + x, threshold 1


def spikes(node, reset, *inputs, pieces=1):
    whole = chain(nir.Affine(np.eye(1), np.zeros(1)), node, width=1, act=1)
    graph = FloatGraph(Artifact(whole, None, Convention(1e-3, reset, state="kept")))
    rows = np.array_split(np.array(inputs, float)[None, :, None], pieces, axis=1)
    return np.concatenate([graph.run(part)["n2"].ravel() for part in rows]).tolist()


@pytest.mark.parametrize(
    ("reset", "found"),
    [
        # 4 -> 0; 0; 0
        ("zero", [1, 0, 0, 0]),
        # 4 -> 3; 1.5 -> 0.5; 0.25
        ("subtract", [1, 1, 0, 0]),
        # 4; 0 + 0
        ("zero-delayed", [1, 0, 0, 0]),
        # 4; 2 - 1 = 1; 0.5
        ("subtract-delayed", [1, 0, 0, 0]),
        # 4 -> 3, still above; 1.5 - 1 = 0.5, given back: 1.5; 0.75 - 1 = -0.25, given back: 0.75
        ("subtract-ahead", [1, 0, 0, 0]),
        # 4, 2, 1
        ("none", [1, 1, 0, 0]),
    ],
)
def test_a_single_input_by_each_reset(reset, found):
    assert spikes(HALVING, reset, 4, 0, 0, 0) == found


def test_a_delayed_subtraction_is_not_halved_with_the_membrane():
    # delayed: 1.6; 0.8 + 1.3 - 1 = 1.1; subtract: 1.6 -> 0.6; 0.3 + 1.3 = 1.6 -> 0.6; 0.3 + 0.8
    assert spikes(HALVING, "subtract-delayed", 1.6, 1.3, 0.8) == [1, 1, 0]
    assert spikes(HALVING, "subtract", 1.6, 1.3, 0.8) == [1, 1, 1]


def test_subtraction_ahead_needs_twice_the_threshold():
    # 4 -> 3; 1.5 + 0.4 - 1 = 0.9 no; 1.9: given back; with 0.6: 1.5 + 0.6 - 1 = 1.1 yes
    assert spikes(HALVING, "subtract-ahead", 4, 0.4) == [1, 0]
    assert spikes(HALVING, "subtract-ahead", 4, 0.6) == [1, 1]


def test_a_delayed_reset_to_zero_discards_the_input_of_a_cubalif_and_keeps_that_of_a_lif():
    current_based = cuba(1, alpha=0.0, beta=0.5, dt=1e-3, threshold=1.0)
    assert spikes(HALVING, "zero-delayed", 2, 2, 2) == [1, 1, 1]
    assert spikes(current_based, "zero-delayed", 2, 2, 2) == [1, 0, 1]
