"""Dense and LIF processes of lava-nc, bit-accurate: https://github.com/lava-nc/lava (BSD-3).

lava-nc 0.10.0 refuses Python 3.11 and newer; on 3.10 it runs. Row t is lava's timestep t + 1, and
each Dense delays by a timestep. Weights of a trace with `exc_inh_split` come from two processes,
one of weights from 0 and one of weights to 0, as Loihi's two lists. `delays` are those of its
DelayDense, which adds so many timesteps to the one of a Dense; monitors read after the neurons
have spiked.
"""

from typing import Any

import numpy as np
from lava.magma.core.run_conditions import RunSteps
from lava.magma.core.run_configs import Loihi1SimCfg
from lava.proc.dense.process import DelayDense, Dense
from lava.proc.io.sink import RingBuffer as Sink
from lava.proc.io.source import RingBuffer as Source
from lava.proc.lif.process import LIF
from lava.proc.monitor.process import Monitor
from lava.utils.weightutils import SignMode

PACKAGES = ("lava-nc", "numpy")
# of a trace that names no exponents or widths
DEFAULTS = {"weight_exp": 0, "num_weight_bits": 8, "bias_mant": 0, "bias_exp": 0}


def record(trace: dict[str, Any]) -> dict[str, Any]:
    """Currents u, membranes v and spikes s, (T, N), of one layer or of each of `layers`."""
    raster = np.array(trace["input_spikes"])
    layers = trace.get("layers") or [trace["params"]]
    recorded = _run(raster, [{**DEFAULTS, "exc_inh_split": True, **each} for each in layers])
    return {"layers": recorded} if "layers" in trace else recorded[0]


def _run(raster: Any, layers: list[dict[str, Any]]) -> list[dict[str, Any]]:  # noqa: ANN401
    """All layers, one after another."""
    timesteps = len(raster)
    source = Source(data=raster.T)
    port, probes, processes = source.s_out, [], []
    for params in layers:
        neurons = _neurons(params)
        connections = [(port, _dense(params))]
        if "weights_input" in params:
            connections.append((source.s_out, _dense(params, "weights_input")))
        for spikes, lists in connections:
            for dense in lists:
                spikes.connect(dense.s_in)
                dense.a_out.connect(neurons.a_in)
                processes.append(dense)
        sink = Sink(shape=neurons.s_out.shape, buffer=timesteps)
        neurons.s_out.connect(sink.a_in)
        monitors = {name: Monitor() for name in ("u", "v")}
        for name, monitor in monitors.items():
            monitor.probe(getattr(neurons, name), timesteps)
        probes.append((neurons, monitors, sink))
        port = neurons.s_out
    source.run(RunSteps(num_steps=timesteps), Loihi1SimCfg(select_tag="fixed_pt"))
    try:
        return [_recorded(*each) for each in probes]
    finally:
        source.stop()


def _neurons(params: dict[str, Any]) -> LIF:
    return LIF(
        shape=(len(params["weights"]),),
        **{name: params[name] for name in ("du", "dv", "vth", "bias_mant", "bias_exp")},
    )


def _dense(params: dict[str, Any], name: str = "weights") -> list[Any]:
    """One process of weights of both signs, or one of each sign."""
    weights, make = np.array(params[name]), Dense
    options = {key: params[key] for key in ("weight_exp", "num_weight_bits")}
    if name == "weights" and "delays" in params:
        # a delay of the trace counts the timestep of every Dense
        make, options["delays"] = DelayDense, np.array(params["delays"]) - 1
    if not params["exc_inh_split"]:
        return [make(weights=weights, sign_mode=SignMode.MIXED, **options)]
    return [
        make(weights=np.maximum(weights, 0), sign_mode=SignMode.EXCITATORY, **options),
        make(weights=np.minimum(weights, 0), sign_mode=SignMode.INHIBITORY, **options),
    ]


def _recorded(neurons: LIF, monitors: dict[str, Monitor], sink: Sink) -> dict[str, Any]:
    rows = {
        name: next(iter(monitor.get_data()[neurons.name].values()))
        for name, monitor in monitors.items()
    }
    return {
        **{name: values.astype(np.int64).tolist() for name, values in rows.items()},
        "s": sink.data.get().T.astype(np.int64).tolist(),
    }
