"""Exports a network of snnTorch's default neurons, with spikes that it computed, for `check`.

pip install "snntorch==1.0.0" "nirtorch==2.6"
python examples/from_snntorch.py [FOLDER]
spikedeploy check snntorch.nir --from snntorch --against snntorch.npz
"""

import sys
from pathlib import Path

import nir
import numpy as np
import snntorch
import torch
from snntorch.export_nir import export_to_nir


def neurons(size: int) -> snntorch.Leaky:
    """Leaky as by default: its export needs beta and threshold as one number for each neuron."""
    return snntorch.Leaky(torch.full((size,), 0.9), torch.ones(size), init_hidden=True)


if __name__ == "__main__":
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else Path()
    torch.manual_seed(0)
    linear = torch.nn.Linear
    net = torch.nn.Sequential(linear(16, 32), neurons(32), linear(32, 4), neurons(4))
    # the batch is no axis of NIR
    nir.write(folder / "snntorch.nir", export_to_nir(net, torch.zeros(1, 16), ignore_dims=[0]))
    net[1].reset_mem(), net[3].reset_mem()
    spikes = (torch.rand(100, 16) < 0.5).float()
    with torch.no_grad():
        output = torch.stack([net(row[None])[0] for row in spikes])
    np.savez(folder / "snntorch.npz", input=spikes.numpy(), output=output.numpy())
    print(f"wrote snntorch.nir and snntorch.npz: {int(output.sum())} output spikes")
