"""One layer on brian2-loihi's Loihi: https://github.com/sagacitysite/brian2_loihi (MIT).

It needs numpy below 2. Inputs act in the timestep of their row; the membrane is read at the end of
a timestep, after the reset; the current when the synapses have delivered.
"""

from collections.abc import Iterator
from typing import Any

import brian2
import numpy as np
from brian2_loihi import (
    LoihiNetwork,
    LoihiNeuronGroup,
    LoihiSpikeGeneratorGroup,
    LoihiSpikeMonitor,
    LoihiStateMonitor,
    LoihiSynapses,
    synapse_sign_mode,
)

PACKAGES = ("brian2-loihi", "brian2", "numpy")
SIGN_MODES = {
    "weights_exc": synapse_sign_mode.EXCITATORY,
    "weights_inh": synapse_sign_mode.INHIBITORY,
    "weights_mixed": synapse_sign_mode.MIXED,
}


def record(trace: dict[str, Any]) -> dict[str, Any]:
    """Currents u, membranes v and spikes s, (T, N), of the trace's network and input."""
    brian2.prefs.codegen.target = "numpy"
    params, raster = trace["params"], np.array(trace["input_spikes"])
    timesteps, width = raster.shape
    source = LoihiSpikeGeneratorGroup(width, *np.nonzero(raster.T))
    neurons = LoihiNeuronGroup(
        len(next(weights for _, weights in _matrices(params))),
        refractory=params["refractory"],
        threshold_v_mant=params["vth_mant"],
        decay_v=params["decay_v"],
        decay_I=params["decay_u"],
    )
    synapses = {name: _synapses(source, neurons, name, params) for name, _ in _matrices(params)}
    monitors = {name: LoihiStateMonitor(neurons, name) for name in ("I", "v")}
    spikes = LoihiSpikeMonitor(neurons)
    LoihiNetwork(source, neurons, *synapses.values(), *monitors.values(), spikes).run(timesteps)
    fired = np.zeros((timesteps, neurons.N), np.int64)
    fired[np.array(spikes.t, np.int64), np.array(spikes.i)] = 1
    u, v = (np.array(getattr(monitors[name], name)).T.astype(np.int64) for name in ("I", "v"))
    recorded: dict[str, Any] = {"u": u.tolist(), "v": v.tolist(), "s": fired.tolist()}
    if "weights_effective_reported" in params:
        recorded["params"] = {"weights_effective_reported": dict(_effective(params, synapses))}
    return recorded


def _matrices(params: dict[str, Any]) -> Iterator[tuple[str, Any]]:
    """Name and weights (post, pre) of each matrix that the trace has."""
    return ((name, params[name]) for name in SIGN_MODES if params.get(name) is not None)


def _synapses(source: Any, neurons: Any, name: str, params: dict[str, Any]) -> Any:  # noqa: ANN401
    """All to all, with the weights of that name."""
    synapses = LoihiSynapses(
        source,
        neurons,
        w_exp=params["weight_exp"],
        sign_mode=SIGN_MODES[name],
        num_weight_bits=params["num_weight_bits"],
    )
    synapses.connect()
    # one after another as brian2 numbers them: all targets of the first source, then of the second
    synapses.w = np.array(params[name], np.int64).T.ravel()
    return synapses


def _effective(params: dict[str, Any], synapses: dict[str, Any]) -> Iterator[tuple[str, Any]]:
    """Weights (post, pre) as the tool says that they count."""
    for name, weights in _matrices(params):
        shape = np.array(weights).T.shape
        counted = np.array(synapses[name].w_act).astype(np.int64).reshape(shape).T
        yield name.removeprefix("weights_"), counted.tolist()
