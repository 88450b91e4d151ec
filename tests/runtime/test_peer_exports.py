"""What other tools export and compute today, read with --from: every spike is the same.

`./spike test --peers` installs snnTorch's, Norse's and SpikingJelly's exports; the golden files
that the suite reads without them are compared with what the tools write now.
"""

import nir
import numpy as np
import pytest

from lab.peers.exported_networks import CASES, FOLDER, record
from spikedeploy.runtime.artifact.artifact import load
from spikedeploy.runtime.float_model import FloatGraph

pytestmark = pytest.mark.filterwarnings("ignore")
MODULES = {
    "snntorch": "snntorch.export_nir",
    "norse": "norse.torch",
    "spikingjelly": "spikingjelly.activation_based.nir_exchange",
}


@pytest.mark.parametrize("name", CASES)
def test_an_export_of_today_means_the_same_spikes(name, tmp_path):
    case = CASES[name]
    reason = f"{case.tool}'s export is not installed; ./spike test --peers compares with it"
    pytest.importorskip(MODULES[case.tool], reason=reason, exc_type=ImportError)
    network, trace = record(name, tmp_path)
    inputs, outputs = np.load(trace)["input"], np.load(trace)["output"]
    found = FloatGraph(load(network, **{"written_by": case.tool, **case.options})).run(inputs[None])
    np.testing.assert_array_equal(found["output"][0], outputs)
    with np.load(FOLDER / f"{name}.npz") as golden:
        np.testing.assert_array_equal(golden["output"], outputs)
    committed, now = nir.read(FOLDER / f"{case.file}.nir"), nir.read(network)
    assert set(committed.edges) == set(now.edges)
    for key, node in now.nodes.items():
        for field, value in vars(node).items():
            if isinstance(value, np.ndarray):
                np.testing.assert_array_equal(value, getattr(committed.nodes[key], field))
