"""The networks of examples/networks.py keep the design rules of the chips that they name."""

import pytest

torch = pytest.importorskip("torch")
snn = pytest.importorskip("snntorch")

from torch import nn  # noqa: E402

import spikedeploy as sd  # noqa: E402
from examples import networks  # noqa: E402


def for_spiker(inputs):
    has = {"beta": 0.9375, "reset_mechanism": "subtract", "reset_delay": False}
    return nn.Sequential(
        nn.Linear(inputs, 12, bias=False), snn.Leaky(**has),
        nn.Linear(12, 6, bias=False), snn.Leaky(**has),
    )  # fmt: skip


MADE_FOR = {
    networks.for_loihi: ("loihi1", "loihi2", "spinnaker2"),
    networks.RecurrentForLoihi: ("loihi1", "loihi2"),
    networks.for_xylo: ("xylo-a2", "xylo-a3", "xylo-imu"),
    networks.for_speck: ("speck2f",),
    networks.for_odin: ("odin", "tinyodin", "truenorth"),
    for_spiker: ("spiker",),
}


# snnTorch's own subtraction; axons with signs or types
@pytest.mark.filterwarnings("ignore:.*(the nearest|until it is trained):UserWarning")
@pytest.mark.parametrize(
    ("make", "name"), [(make, name) for make, names in MADE_FOR.items() for name in names]
)
def test_a_network_fits_the_chip_that_it_is_made_for(make, name, tmp_path):
    torch.manual_seed(0)
    module = sd.on_chip(make(16), name, input_shape=(16,))
    spikes = (torch.rand(6, 4, 16) < 0.4).float()
    module(spikes).sum().backward()
    file = module.save(tmp_path / "net.nir")
    assert sd.load(file).check(name).passed
