"""Exports a network of SpikingJelly's LIFNode, with spikes that it computed, for `check`.

pip install "spikingjelly==2.0.0" "nirtorch==2.6"
python examples/from_spikingjelly.py [FOLDER]
spikedeploy check spikingjelly.nir --from spikingjelly --against spikingjelly.npz
"""

import sys
from pathlib import Path

import numpy as np
import torch
from spikingjelly.activation_based import functional, layer, neuron
from spikingjelly.activation_based.nir_exchange import export_to_nir

if __name__ == "__main__":
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else Path()
    torch.manual_seed(0)
    net = torch.nn.Sequential(
        layer.Linear(16, 32), neuron.LIFNode(tau=2.0), layer.Linear(32, 4), neuron.LIFNode(tau=2.0)
    )
    net[0].weight.data *= 5
    net[2].weight.data *= 5
    export_to_nir(net, torch.zeros(1, 16), save_path=folder / "spikingjelly.nir")
    functional.reset_net(net)
    spikes = (torch.rand(100, 16) < 0.5).float()
    with torch.no_grad():
        output = torch.stack([net(row[None])[0] for row in spikes])
    np.savez(folder / "spikingjelly.npz", input=spikes.numpy(), output=output.numpy())
    print(f"wrote spikingjelly.nir and spikingjelly.npz: {int(output.sum())} output spikes")
