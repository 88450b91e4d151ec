"""Layers on brian2-loihi's Loihi: https://github.com/sagacitysite/brian2_loihi (MIT).

It needs numpy below 2. A timestep of its network is input, synapses, neurons, thresholds, resets:
inputs act in the timestep of their row, spikes of neurons in the next. The membrane is read at the
end of a timestep, after the reset; the current when the synapses have delivered. Its synapses add a
delay of their own to that.
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
    """Currents u, membranes v and spikes s, (T, N), of one layer or of each of `layers`."""
    brian2.prefs.codegen.target = "numpy"
    raster = np.array(trace["input_spikes"])
    if "layers" in trace:
        return {"layers": _run(raster, [_by_sign(layer) for layer in trace["layers"]])[0]}
    params = trace["params"]
    (recorded,), synapses = _run(raster, [params])
    if "weights_effective_reported" in params:
        recorded["params"] = {"weights_effective_reported": dict(_effective(params, synapses))}
    return recorded


def _run(raster: Any, layers: list[dict[str, Any]]) -> tuple[list[dict[str, Any]], dict[str, Any]]:  # noqa: ANN401
    """Each layer's recording, and the synapses of the first by the name of their weights."""
    timesteps, width = raster.shape
    source = LoihiSpikeGeneratorGroup(width, *np.nonzero(raster.T))
    groups, probes, connections = [source], [], []
    for params in layers:
        neurons = LoihiNeuronGroup(
            len(next(weights for _, weights in _matrices(params))),
            refractory=params["refractory"],
            threshold_v_mant=params["vth_mant"],
            decay_v=params["decay_v"],
            decay_I=params["decay_u"],
        )
        connections.append(_synapses(groups[-1], neurons, params, len(groups) > 1))
        if "input" in params:
            connections.append(_synapses(source, neurons, {**params, **params["input"]}))
        monitors = {name: LoihiStateMonitor(neurons, name) for name in ("I", "v")}
        probes.append((neurons, monitors, LoihiSpikeMonitor(neurons)))
        groups.append(neurons)
    everything = [each for _, monitors, spikes in probes for each in (*monitors.values(), spikes)]
    synapses = [each for named in connections for each in named.values()]
    LoihiNetwork(*groups, *synapses, *everything).run(timesteps)
    return [_recorded(timesteps, *each) for each in probes], connections[0]


def _recorded(
    timesteps: int,
    neurons: Any,  # noqa: ANN401
    monitors: dict[str, Any],
    spikes: Any,  # noqa: ANN401
) -> dict[str, Any]:
    fired = np.zeros((timesteps, neurons.N), np.int64)
    fired[np.array(spikes.t, np.int64), np.array(spikes.i)] = 1
    u, v = (np.array(getattr(monitors[name], name)).T.astype(np.int64) for name in ("I", "v"))
    return {"u": u.tolist(), "v": v.tolist(), "s": fired.tolist()}


def _by_sign(layer: dict[str, Any]) -> dict[str, Any]:
    """A layer of a chain with its weights in a list for each sign."""
    signs = _signs(layer["weights"])
    skip = {"input": _signs(layer["weights_input"])} if "weights_input" in layer else {}
    if skip:
        skip["input"]["delays"] = None
    return {"weight_exp": 0, "num_weight_bits": 8, **layer, **signs, **skip}


def _signs(weights: Any) -> dict[str, Any]:  # noqa: ANN401
    found = np.array(weights)
    return {"weights_exc": np.maximum(found, 0), "weights_inh": np.minimum(found, 0)}


def _matrices(params: dict[str, Any]) -> Iterator[tuple[str, Any]]:
    """Name and weights (post, pre) of each matrix that the trace has."""
    return ((name, params[name]) for name in SIGN_MODES if params.get(name) is not None)


def _synapses(
    source: Any,  # noqa: ANN401
    neurons: Any,  # noqa: ANN401
    params: dict[str, Any],
    least: int = 0,
) -> dict[str, Any]:
    """All to all, a group of synapses for each matrix of weights and each delay, by their names.

    least: delay of synapses to which none is given [timesteps]: of the input 0, of neurons 1.
    """
    made = {}
    for name, weights in _matrices(params):
        matrix = np.array(weights, np.int64)
        given = params.get("delays")
        delays = np.full(matrix.shape, least) if given is None else np.array(given)
        for delay in np.unique(delays):
            group = LoihiSynapses(
                source,
                neurons,
                delay=int(delay) - least,
                w_exp=params["weight_exp"],
                sign_mode=SIGN_MODES[name],
                num_weight_bits=params["num_weight_bits"],
            )
            group.connect()
            # as brian2 numbers them: all targets of the first source, then of the second
            group.w = np.where(delays == delay, matrix, 0).T.ravel()
            made[name if given is None else f"{name} {delay}"] = group
    return made


def _effective(params: dict[str, Any], synapses: dict[str, Any]) -> Iterator[tuple[str, Any]]:
    """Weights (post, pre) as the tool says that they count."""
    for name, weights in _matrices(params):
        shape = np.array(weights).T.shape
        counted = np.array(synapses[name].w_act).astype(np.int64).reshape(shape).T
        yield name.removeprefix("weights_"), counted.tolist()
