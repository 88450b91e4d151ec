"""Makes `net.nir` and `raster.npy`: a recurrent network in plain NIR, and spikes to put into it.

16 inputs, 40 recurrent CuBa-LIF neurons, 8 CuBa-LIF neurons; random weights, timesteps of 1 ms.

    python examples/make_net.py [FOLDER]
"""

import sys
from pathlib import Path

import nir
import numpy as np

rng = np.random.default_rng(0)


def full(size: int, value: float) -> np.ndarray:
    """The same value for every neuron."""
    return np.full(size, value)


def neurons(size: int) -> nir.CubaLIF:
    """Decay factors 1/2 of the current and 7/8 of the membrane, gains 1, threshold 2."""
    return nir.CubaLIF(
        tau_syn=full(size, 2e-3),
        tau_mem=full(size, 8e-3),
        r=full(size, 8.0),  # tau_mem / dt
        v_leak=full(size, 0.0),
        v_threshold=full(size, 2.0),
        w_in=full(size, 2.0),  # tau_syn / dt
    )


def network() -> nir.NIRGraph:
    """Two layers in a row, the first with feedback of one timestep."""
    nodes = {
        "input": nir.Input(np.array([16])),
        "in": nir.Affine(rng.normal(size=(40, 16)) / 4, np.zeros(40)),
        "hidden": neurons(40),
        "rec": nir.Linear(rng.normal(size=(40, 40)) / 20),
        "out": nir.Linear(rng.normal(size=(8, 40)) / 6),
        "last": neurons(8),
        "output": nir.Output(np.array([8])),
    }
    edges = [
        ("input", "in"),
        ("in", "hidden"),
        ("hidden", "rec"),
        ("rec", "hidden"),
        ("hidden", "out"),
        ("out", "last"),
        ("last", "output"),
    ]
    return nir.NIRGraph(nodes, edges)


if __name__ == "__main__":
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent
    nir.write(folder / "net.nir", network())
    np.save(folder / "raster.npy", (rng.random((200, 16)) < 0.2).astype(np.uint8))
