"""Networks as a user writes them, for `--network tests.own_networks:Net`."""

import snntorch as snn
import torch
from torch import nn


def leaky():
    return snn.Leaky(beta=0.9, reset_mechanism="zero", reset_delay=False, init_hidden=True)


class Net(nn.Module):
    """Two hidden layers, states inside; made for any numbers of inputs and actions."""

    def __init__(self, inputs, actions):
        super().__init__()
        self.fc1, self.lif1 = nn.Linear(inputs, 12), leaky()
        self.fc2, self.lif2 = nn.Linear(12, 3 * actions), leaky()

    def forward(self, x):
        return self.lif2(self.fc2(self.lif1(self.fc1(x))))


class Recurrent(nn.Module):
    """A recurrent layer and membranes as output, of its own number of inputs."""

    def __init__(self):
        super().__init__()
        self.fc1, self.fc2 = nn.Linear(24, 10), nn.Linear(10, 4)
        self.lif1 = snn.RLeaky(
            beta=0.8, linear_features=10, reset_mechanism="zero", reset_delay=False,
            init_hidden=True,
        )  # fmt: skip
        self.out = snn.Leaky(beta=0.9, reset_mechanism="none", init_hidden=True, output=True)

    def forward(self, x):
        return self.out(self.fc2(self.lif1(self.fc1(x))))[1]


def integrators():
    """Layers without a leak, for chips that have none; a function that makes the network."""
    return nn.Sequential(
        nn.Linear(24, 12, bias=False), snn.Leaky(1.0, init_hidden=True, reset_delay=False),
        nn.Linear(12, 6, bias=False), snn.Leaky(1.0, init_hidden=True, reset_delay=False),
    )  # fmt: skip


instance = Net(24, 2)


class Greedy(nn.Module):
    """Asks for more than sizes."""

    def __init__(self, inputs, actions, hidden):
        super().__init__()


def broken(inputs):
    return nn.Linear(inputs, "eight")


def nothing():
    return torch.zeros(1)


class Subtracts(Net):
    """The same, whose spikes subtract the threshold."""

    def __init__(self, inputs, actions):
        super().__init__(inputs, actions)
        for each in (self.lif1, self.lif2):
            each.reset_mechanism = "subtract"


class Tied(nn.Module):
    """Two layers with one matrix."""

    def __init__(self, inputs):
        super().__init__()
        self.fc1, self.lif1 = nn.Linear(inputs, inputs), leaky()
        self.fc2, self.lif2 = nn.Linear(inputs, inputs), leaky()
        self.fc2.weight = self.fc1.weight

    def forward(self, x):
        return self.lif2(self.fc2(self.lif1(self.fc1(x))))
