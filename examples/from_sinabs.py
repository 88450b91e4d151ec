"""Exports a network of sinabs that takes events, with spikes that it computed, for `check`.

pip install --no-deps sinabs==3.1.3 nirtorch==2.6 pbr
python examples/from_sinabs.py [FOLDER]
spikedeploy check sinabs.nir --from sinabs --against sinabs.npz
"""

import sys
from pathlib import Path

import nir
import numpy as np
import torch
from sinabs.layers import IAFSqueeze, SumPool2d
from sinabs.nir import to_nir

CHANNELS, HEIGHT, WIDTH = 2, 16, 32


def network() -> torch.nn.Sequential:
    """Two convolutions with sum pools and a fully connected layer, of random weights.

    Yours has trained ones. Without biases, which Speck adds by a clock of its own.
    """

    def convolution(inputs: int, outputs: int) -> torch.nn.Conv2d:
        made = torch.nn.Conv2d(inputs, outputs, 3, padding=1, bias=False)
        torch.nn.init.normal_(made.weight, 0.04, 0.2)
        return made

    linear = torch.nn.Linear(8 * (HEIGHT // 4) * (WIDTH // 4), 4, bias=False)
    torch.nn.init.normal_(linear.weight, 0.01, 0.08)
    return torch.nn.Sequential(
        convolution(CHANNELS, 4), IAFSqueeze(batch_size=1), SumPool2d((2, 2), stride=(2, 2)),
        convolution(4, 8), IAFSqueeze(batch_size=1), SumPool2d((2, 2), stride=(2, 2)),
        torch.nn.Flatten(), linear, IAFSqueeze(batch_size=1),
    )  # fmt: skip


if __name__ == "__main__":
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else Path()
    torch.manual_seed(0)
    net = network()
    graph = to_nir(net, torch.zeros(1, CHANNELS, HEIGHT, WIDTH))
    graph.infer_types()  # shapes of convolutions, which sinabs 3.1.3 leaves out and nir needs
    nir.write(folder / "sinabs.nir", graph)
    for layer in net:
        if isinstance(layer, IAFSqueeze):
            layer.reset_states()
    events = (torch.rand(100, CHANNELS, HEIGHT, WIDTH) < 0.02).float()
    with torch.no_grad():
        output = net(events)
    np.savez_compressed(
        folder / "sinabs.npz",
        input=events.numpy().astype(np.uint8),
        output=output.numpy().astype(np.uint8),
    )
    print(f"wrote sinabs.nir and sinabs.npz: {int(output.sum())} output spikes")
