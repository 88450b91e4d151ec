"""LIF neurons worked by hand, on every rung from float to the chip."""

import nir
import numpy as np

from spikedeploy.runtime.artifact.artifact import Artifact
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.compiler.compile import compile_program
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.emulator.interpreter import trace
from spikedeploy.runtime.emulator.machine import Machine
from spikedeploy.runtime.float_model import FloatGraph
from tests.networks import chain, lif

LOIHI1 = chip("loihi1")


def neurons(weight, bias, beta, threshold):
    """LIF neurons behind a weight matrix (N, M), without a readout."""
    tau = 1e-3 / (1 - beta)
    layer = lif(len(weight), tau, tau / 1e-3, threshold)
    layer.v_reset = np.zeros(len(weight))
    affine = nir.Affine(np.array(weight), np.array(bias))
    nodes = chain(affine, layer, width=len(weight[0]), act=len(weight))
    return Artifact(nodes, None, Convention(1e-3))


def on_every_rung(artifact, raster):
    """Spikes (T, N) in float, on `ideal`, and on loihi1 interpreted and fast."""
    yield FloatGraph(artifact).run(raster)["n2"][0]
    for name in ("ideal", "loihi1"):
        program = compile_program(artifact, chip(name))
        yield trace(program, raster)["n2"].spikes[0]
        machine = Machine(program, trace=True)
        machine.infer(raster)
        yield machine.recordings["n2"].spikes[0]


def test_a_lif_neuron_worked_by_hand_spikes_alike_on_every_rung():
    # weights 2.55 and -1, bias 0.5, beta 1/2, threshold 3
    #
    # t   input      V = V / 2 + x
    # 0   a          2.55 + 0.5              = 3.05 > 3: spike, then 0
    # 1   b          -1 + 0.5                = -0.5
    # 2   -          -0.25 + 0.5             = 0.25
    # 3   a and b    0.125 + 1.55 + 0.5      = 2.175
    # 4   -          1.0875 + 0.5            = 1.5875
    # 5   a          0.79375 + 3.05          = 3.84375: spike, then 0
    # 6   -          0.5
    artifact = neurons([[2.55, -1.0]], [0.5], beta=0.5, threshold=3.0)
    raster = np.array([[[1, 0], [0, 1], [0, 0], [1, 1], [0, 0], [1, 0], [0, 0]]], np.uint8)
    for spikes in on_every_rung(artifact, raster):
        assert spikes.ravel().tolist() == [1, 0, 0, 0, 0, 1, 0]
    # 255 / 2.55 = 100 mantissas of 64 state units for one float unit; halves are exact
    ran = trace(compile_program(artifact, LOIHI1), raster)["n2"].membrane.ravel().tolist()
    assert ran == [0, -3200, 1600, 13920, 10160, 0, 3200]
