"""Exports a network of Norse's LIFBoxCell, with spikes that it computed, for `check`.

pip install "norse==1.1.0" "nirtorch==2.6"
python examples/from_norse.py [FOLDER]
spikedeploy check norse.nir --from norse --against norse.npz
"""

import sys
from pathlib import Path

import nir
import norse.torch as norse
import numpy as np
import torch


def neurons(size: int) -> norse.LIFBoxCell:
    """LIF neurons: parameters as one number for each, because NIR holds no single numbers."""
    full = {"v_leak": torch.zeros(size), "v_th": torch.ones(size)}
    return norse.LIFBoxCell(norse.LIFBoxParameters(tau_mem_inv=torch.full((size,), 100.0), **full))


if __name__ == "__main__":
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else Path()
    torch.manual_seed(0)
    net = norse.SequentialState(
        torch.nn.Linear(16, 32), neurons(32), torch.nn.Linear(32, 4), neurons(4)
    )
    net[0].weight.data *= 20
    net[2].weight.data *= 20
    # without a batch, which is no axis of NIR
    nir.write(folder / "norse.nir", norse.to_nir(net, torch.zeros(16)))
    spikes, state, rows = (torch.rand(100, 16) < 0.5).float(), None, []
    with torch.no_grad():
        for row in spikes:
            output, state = net(row[None], state)
            rows.append(output[0].numpy())
    np.savez(folder / "norse.npz", input=spikes.numpy(), output=np.array(rows))
    print(f"wrote norse.nir and norse.npz: {int(np.sum(rows))} output spikes")
