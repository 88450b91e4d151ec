"""Networks and rasters whose NeuroBench numbers several tests count."""

import nir
import numpy as np

from spikedeploy.runtime.artifact.artifact import Artifact
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.chips.layer import Synapses
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.emulator.machine import Machine
from spikedeploy.runtime.metrics.neurobench import neurobench
from tests.networks import chain, cuba, lif
from tests.programs import layer

DT = 1e-3
IDEAL = chip("ideal")


def pruned(rng, size, fan_in):
    """Weights of which a third are 0, as float32 holds them."""
    weight = 2 * rng.normal(size=(size, fan_in)) / fan_in**0.5
    return np.where(rng.random(weight.shape) < 0.33, 0, weight).astype(np.float32)


def network(reset="zero", biased=True, seed=0):
    """20 -> 16 LIF -> 12 CuBa-LIF -> 3."""
    rng = np.random.default_rng(seed)
    # snnTorch spikes once where a membrane reached two thresholds and lost one: these never do
    subtract = reset == "subtract"
    leaky = lif(16, tau=DT / 0.1, r=10.0, threshold=6.0 if subtract else 0.5)
    threshold = 12.0 if subtract else 1.5
    current_based = cuba(12, alpha=0.5, beta=0.75, dt=DT, threshold=threshold)
    leaky.v_reset = np.zeros(16)
    maps = [pruned(rng, 16, 20), pruned(rng, 12, 16), pruned(rng, 3, 12)]
    maps = [np.abs(weight) for weight in maps] if subtract else maps
    if biased:
        biases = [0.1 * rng.normal(size=len(weight)).astype(np.float32) for weight in maps]
        nodes = [nir.Affine(*each) for each in zip(maps, biases, strict=True)]
    else:
        nodes = [nir.Linear(weight) for weight in maps]
    whole = chain(nodes[0], leaky, nodes[1], current_based, nodes[2], width=20, act=3)
    return Artifact(whole, None, Convention(DT, reset=reset))


def raster(batch=4, timesteps=16, width=20, rate=0.3):
    rng = np.random.default_rng(1)
    return (rng.random((batch, timesteps, width)) < rate).astype(np.uint8)


def measured(program, graph, spikes):
    """Our numbers of one batch of inferences."""
    machine = Machine(program, len(spikes), trace=True)
    machine.infer(spikes)
    seen = machine.recordings
    return neurobench(
        graph,
        program,
        {program.input: spikes, **{name: rows.spikes for name, rows in seen.items()}},
        {name: rows.membrane for name, rows in seen.items()},
    )


def neurons_of(weight, threshold, **options):
    """One layer of integers on Loihi, which forgets no membrane."""
    chosen = chip("loihi1", **options)
    synapses = (Synapses("input", weight, delay=1),)
    kept = {"decays": (4095, 0), "threshold": threshold << 6, "start": 1}
    neurons = layer(chosen.arithmetic, "n2", weight.T, synapses, **kept)
    return Program(chosen, Convention(DT), "input", len(weight), (neurons,), "n2", None)


def convolutions():
    """Convolutions with strides, groups, dilation and padding, and their input shapes."""
    rng = np.random.default_rng(0)

    def drawn(*shape):
        return rng.normal(size=shape)

    return [
        nir.Conv1d(4, drawn(1, 1, 3), 1, 1, 1, 1, np.zeros(1)),
        nir.Conv1d(11, drawn(6, 2, 3), 2, 2, 2, 3, np.zeros(6)),
        nir.Conv2d((7, 9), drawn(4, 3, 3, 2), (2, 1), (1, 2), (1, 1), 1, np.zeros(4)),
    ]
