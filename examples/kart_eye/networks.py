"""A convolutional network of snnTorch, for `--network examples.kart_eye:EyeSnn`."""

import snntorch as snn
from torch import Tensor, nn


def _leaky() -> nn.Module:
    """LIF neurons that reset to zero in the timestep of the spike, as Loihi's."""
    return snn.Leaky(beta=0.9, reset_mechanism="zero", reset_delay=False, init_hidden=True)


class EyeSnn(nn.Module):
    """Counts of events into two convolutions and a dense layer of LIF neurons."""

    input_shape = (2, 16, 32)  # polarities, rows, columns

    def __init__(self) -> None:
        super().__init__()
        self.layers = nn.Sequential(
            nn.Conv2d(2, 8, 5, stride=2, padding=2), _leaky(),
            nn.Conv2d(8, 16, 3, stride=2, padding=1), _leaky(),
            nn.Flatten(),
            nn.Linear(16 * 4 * 8, 64), _leaky(),
        )  # fmt: skip

    def forward(self, counts: Tensor) -> Tensor:
        """Return the spikes (B, 64) of one timestep for those of the counts (B, 2, 16, 32)."""
        spikes: Tensor = self.layers(counts)
        return spikes
