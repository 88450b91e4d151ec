"""A Xylo core in xylosim 0.1.3, SynSense's simulator, `xylosim.v2`; its wheel is built from source.

Inputs act in the timestep of their row. The simulator holds bare pointers to its synapses: they
have to outlive it.
"""

from typing import Any

import numpy as np
from xylosim.v2 import XyloLayer, XyloSynapse

PACKAGES = ("xylosim",)


def record(trace: dict[str, Any]) -> dict[str, Any]:
    """Currents, membranes and spikes of hidden and output neurons, each (T, N)."""
    params = trace["params"]
    synapses = {name: _synapses(params[name]) for name in ("weights_in", "weights_rec")}
    # outputs have one synapse each
    synapses["weights_out"] = _synapses(np.array(params["weights_out"])[:, :, None])
    shift_in, shift_rec, shift_out = params["weight_shift"]
    layer = XyloLayer(
        synapses_in=synapses["weights_in"],
        synapses_rec=synapses["weights_rec"],
        synapses_out=synapses["weights_out"],
        aliases=params["aliases"] or [[] for _ in params["threshold"]],
        threshold=params["threshold"],
        threshold_out=params["threshold_out"],
        has_bias=any(params["bias"] + params["bias_out"]),
        bias=params["bias"],
        bias_out=params["bias_out"],
        weight_shift_inp=shift_in,
        weight_shift_rec=shift_rec,
        weight_shift_out=shift_out,
        dash_mem=params["dash_mem"],
        dash_mem_out=params["dash_mem_out"],
        dash_syns=np.stack([params["dash_syn"], params["dash_syn_2"]], axis=1).tolist(),
        dash_syns_out=[[dash] for dash in params["dash_syn_out"]],
        name="recorded",
    )
    layer.evolve(trace["input_counts"])
    return {
        "i_syn": _by_step(layer.rec_i_syn),
        "i_syn2": _by_step(layer.rec_i_syn2),
        "v_mem": _by_step(layer.rec_v_mem),
        "hidden_spikes": np.array(layer.rec_recurrent_spikes).tolist(),
        "i_syn_out": _by_step(layer.rec_i_syn_out),
        "v_mem_out": _by_step(layer.rec_v_mem_out),
        "out_spikes": np.array(layer.rec_out_spikes).tolist(),
    }


def _synapses(weights: Any) -> list[list[XyloSynapse]]:  # noqa: ANN401
    """Of each presynaptic neuron those that are not 0; weights are (pre, post, synapse)."""
    return [
        [
            XyloSynapse(target, number, int(weight))
            for target, pair in enumerate(row)
            for number, weight in enumerate(pair)
            if weight
        ]
        for row in np.array(weights).tolist()
    ]


def _by_step(recorded: Any) -> list[list[int]]:  # noqa: ANN401
    """From (N, T) to (T, N)."""
    rows: list[list[int]] = np.array(recorded).T.tolist()
    return rows
