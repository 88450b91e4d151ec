"""Random networks of several layers and their input, as traces that a tool has yet to record.

Inputs reach the first layer and, unless it is a chain, past it the others; the last layer is a
readout, whose threshold is out of reach and whose membranes are probed. Nothing is reset between
control steps. A control step is one timestep (clock pipelined), or several with events in the first
alone (clock free). spikedeploy is not needed, as in lab/peers/record_traces.py.
"""

from itertools import pairwise
from typing import Any

import numpy as np

# neurons of the input and of each layer
SIZES = (10, 12, 8, 3)
# share of inputs with an event in a control step
EVENTS = 0.25
# a threshold mantissa that no membrane reaches
OUT_OF_REACH = (1 << 17) - 1
# chip's largest membrane; nengo-loihi is given it
LARGEST = (1 << 23) - 1
# module of lab.peers.traces -> what a trace says of who recorded it
SOURCES = {
    "lava": "lava-nc, Loihi1SimCfg fixed_pt",
    "nengo_loihi": "nengo-loihi, EmulatorInterface in integers",
    "brian2_loihi": "brian2-loihi, LoihiNetwork",
}


# timesteps from an event to the readout: inputs act in the next one, or in the same
DEPTH = {"lava": 3, "nengo_loihi": 3, "brian2_loihi": 2}
# tools whose synapses have delays, and the longest that is tried [timesteps]
DELAYED = {"lava": 9, "brian2_loihi": 9}


def random_kinds(tool: str) -> dict[str, dict[str, Any]]:
    """Name -> options of `random_trace`: each clock, and delays where the tool has them.

    A chain that runs free has as many timesteps as its events need to reach the readout.
    """
    kinds: dict[str, dict[str, Any]] = {
        "clock_pipelined": {},
        "clock_free": {"control_steps": 40, "timesteps": 3},
        "chain_free": {"control_steps": 40, "timesteps": DEPTH[tool] + 1, "skips": False},
    }
    if tool in DELAYED:
        kinds["delays"] = {"longest_delay": DELAYED[tool]}
    return kinds


def random_trace(
    tool: str,
    seed: int,
    control_steps: int = 60,
    timesteps: int = 1,
    longest_delay: int = 1,
    skips: bool = True,
) -> dict[str, Any]:
    """Network and input of a trace, without what the tool records.

    tool: of SOURCES.
    timesteps: of a control step.
    longest_delay: [timesteps] longest delay of a synapse between neurons; 1 leaves out `delays`.
    skips: whether the input reaches layers behind the first too.
    """
    rng = np.random.default_rng(seed)
    raster = np.zeros((control_steps, timesteps, SIZES[0]), np.int64)
    raster[:, 0] = rng.random((control_steps, SIZES[0])) < EVENTS
    layers = []
    for place, (fan_in, size) in enumerate(pairwise(SIZES)):
        layer = {"weights": _weights(rng, size, fan_in, -200 if place else -160)}
        if place and skips:
            layer["weights_input"] = _weights(rng, size, SIZES[0], -200)
        if longest_delay > 1:
            layer["delays"] = rng.integers(1, longest_delay + 1, (size, fan_in)).tolist()
        last = place == len(SIZES) - 2
        layers.append({**layer, **_neurons(tool, rng, size, last)})
    clock = "pipelined" if timesteps == 1 else f"free, {timesteps} timesteps a control step"
    return {
        "name": f"{tool} clock seed {seed}",
        "source": SOURCES[tool],
        "kind": f"random layers{', skips from the input' * skips}, a readout; clock {clock}",
        "input_spikes": raster.reshape(-1, SIZES[0]).tolist(),
        "layers": layers,
    }


def _weights(rng: np.random.Generator, size: int, fan_in: int, least: int) -> list[list[int]]:
    """Mantissas (size, fan_in); more of them positive, so that neurons spike."""
    return rng.integers(least, 256, (size, fan_in)).tolist()


def _neurons(tool: str, rng: np.random.Generator, size: int, readout: bool) -> dict[str, Any]:
    """Fields of a layer's neurons, by the names that the tool's traces have."""
    # registers: fast currents, slow membranes; of the readout nearly an integrator
    current = int(rng.integers(1000, 4095))
    membrane = 1 if readout else int(rng.integers(50, 1500))
    mantissa = OUT_OF_REACH if readout else int(rng.integers(150, 500))
    bias = 0 if readout else int(rng.integers(-200, 1500))
    if tool == "lava":
        neurons = {"du": current, "dv": membrane, "vth": mantissa, "bias_mant": bias}
        return {**neurons, "bias_exp": 0}
    if tool == "brian2_loihi":
        neurons = {"decay_u": current, "decay_v": membrane, "vth_mant": mantissa}
        return {**neurons, "refractory": 1}
    return {
        "decay_u": current,
        "decay_v": membrane,
        "vth_effective": mantissa << 6,
        "bias": bias,
        "refract_delay": 1,
        "vmin": -LARGEST,
        "vmax": LARGEST,
    }
