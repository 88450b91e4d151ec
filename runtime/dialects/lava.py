"""Lava: its import in the NIR paper; its export by lava_to_nir.py, for the .net files of lava-dl.

The export is read in its source and worked out by hand; no test can run it.
"""

import nir
import numpy as np

from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.dialects.dialect import (
    Assumption,
    Preset,
    Writer,
    float64,
    is_close,
    require,
    tau_over_r,
    with_gain,
    with_zero_reset,
)

_KINDS = (nir.Affine, nir.Linear, nir.CubaLIF)


def _read(name: str, node: nir.NIRNode, convention: Convention) -> nir.NIRNode:
    if isinstance(node, nir.Affine):
        require(np.abs(node.bias) <= 1e-8, name, "reads no bias of an Affine")
    if not isinstance(node, (nir.LIF, nir.CubaLIF)):
        return node
    require(node.v_leak == 0, name, "needs v_leak = 0")
    if isinstance(node, nir.LIF):
        # the import scales the weights before it by dt/tau and ignores r
        return with_zero_reset(node, r=np.ones(node.r.shape))
    unit = is_close(node.r, float64(node.tau_mem) / convention.dt)
    require(unit, name, "needs r = tau_mem/dt")
    return with_zero_reset(node)


PRESET = Preset(
    tool="Lava 0.10.0 (float)",
    kinds=(*_KINDS, nir.LIF),
    convention=lambda nodes: Convention(1e-4, delay=1),
    options=("dt",),
    translate=_read,
    source="github.com/neuromorphs/NIR paper/nir_to_lava.py; a Dense has a delay of one timestep",
)


def _as_meant(name: str, node: nir.NIRNode, convention: Convention) -> nir.NIRNode:
    if isinstance(node, nir.Affine):
        no_network = "divides weights by 64 and not biases, which is no network that ran"
        require(node.bias == 0, name, f"{no_network}: biases must be 0")
    if not isinstance(node, nir.CubaLIF):
        return node
    require(node.v_leak == 0, name, "writes v_leak = 0")
    return with_gain(with_zero_reset(node), convention)


WRITER = Writer(
    tool="Lava (lava_to_nir.py)",
    kinds=_KINDS,
    # decays of a Loihi neuron have no dt; the script writes tau = dt/decay with 1e-4
    timestep=tau_over_r,
    translate=_as_meant,
    source="github.com/neuromorphs/NIR docs/source/examples/lava/lava_to_nir.py, for the .net "
    "files of lava-dl",
    open={
        "delay": Assumption(
            (1, 0),
            "a delay of one timestep into each layer, as Lava runs the network (--delay 0 for "
            "lava-dl without delay_shift)",
        ),
        "spikes": Assumption(
            ("above", "reached"),
            "spikes above the threshold, as in Lava (--spikes reached for lava-dl)",
        ),
    },
)
