"""Networks of snnTorch whose neurons a chip has, for `--network examples.networks:for_speck`.

    spikedeploy distill PILOT --env CartPole-v1 --network examples.networks:for_loihi --for loihi1

Two hidden layers and eight output neurons; each is made for the number of its inputs. What decides
whether a chip has a neuron is the leak, the reset, and whether the reset comes in the timestep of
the spike (reset_delay=False); docs/snntorch-to-chips.md has the table.
"""

from itertools import pairwise

import snntorch as snn
from torch import Tensor, nn

HIDDEN, OUTPUTS = (32, 16), 8


def _layers(inputs: int, neurons: type[nn.Module], bias: bool, **settings: object) -> nn.Sequential:
    widths = (inputs, *HIDDEN, OUTPUTS)
    layers: list[nn.Module] = []
    for before, after in pairwise(widths):
        layers += [
            nn.Linear(before, after, bias=bias),
            neurons(init_hidden=True, reset_delay=False, **settings),
        ]
    return nn.Sequential(*layers)


def for_loihi(inputs: int) -> nn.Sequential:
    """Make LIF neurons that reset to zero: Loihi 1 and 2, SpiNNaker 2."""
    return _layers(inputs, snn.Leaky, True, beta=0.9, reset_mechanism="zero")


class RecurrentForLoihi(nn.Module):
    """The same with a second layer that hears its own spikes a timestep later."""

    def __init__(self, inputs: int) -> None:
        super().__init__()
        lif = {"init_hidden": True, "reset_delay": False, "reset_mechanism": "zero"}
        self.fc1, self.lif1 = nn.Linear(inputs, HIDDEN[0]), snn.Leaky(beta=0.9, **lif)
        self.fc2 = nn.Linear(*HIDDEN)
        self.lif2 = snn.RLeaky(beta=0.9, linear_features=HIDDEN[1], **lif)
        self.fc3, self.lif3 = nn.Linear(HIDDEN[1], OUTPUTS), snn.Leaky(beta=0.9, **lif)

    def forward(self, x: Tensor) -> Tensor:
        """Return the output spikes of one timestep."""
        x = self.lif2(self.fc2(self.lif1(self.fc1(x))))
        spikes: Tensor = self.lif3(self.fc3(x))
        return spikes


def for_xylo(inputs: int) -> nn.Sequential:
    """Make neurons with a current, decays of 1 - 2^-k, and a reset by subtraction: Xylo."""
    return _layers(inputs, snn.Synaptic, False, alpha=0.5, beta=0.9375, reset_mechanism="subtract")


def for_speck(inputs: int) -> nn.Sequential:
    """Make integrators without a leak or a bias, and a reset by subtraction: Speck."""
    return _layers(inputs, snn.Leaky, False, beta=1.0, reset_mechanism="subtract")


def for_odin(inputs: int) -> nn.Sequential:
    """Make integrators without a leak or a bias that reset to zero: ODIN, tinyODIN, TrueNorth."""
    return _layers(inputs, snn.Leaky, False, beta=1.0, reset_mechanism="zero")
