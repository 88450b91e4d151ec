"""Runs of SANA-FE's Loihi and TrueNorth: https://github.com/SLAM-Lab/SANA-FE (GPL-3).

A trace with `setup` is an energy of its Loihi, arch/loihi.yaml. A trace with `networks` is neurons
of its TrueNorth without hard limits; a spike is delivered one timestep after its row.
"""

import re
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import sanafe

PACKAGES = ("sanafe",)
# the sentence of a trace's `setup`
SETUP = re.compile(
    r"(\d+) input neurons spiking (\[[01,]+\]) -> all-to-all -> (\d+) loihi_lif neurons "
    r"\(threshold ([0-9.e+]+)\), one core, (\d+) steps"
)


def record(trace: dict[str, Any]) -> dict[str, Any]:
    """Counts and energies [J] of a `setup`, or membranes and spikes (T, N) of `networks`."""
    if "networks" in trace:
        return {"networks": [_truenorth(network) for network in trace["networks"]]}
    return {"result": _loihi(trace["setup"])}


def _loihi(setup: str) -> dict[str, Any]:
    if (found := SETUP.fullmatch(setup)) is None:
        raise ValueError(f"setup {setup!r} is not of the form {SETUP.pattern!r}")
    inputs, pattern, size, threshold, steps = found.groups()
    architecture, net = sanafe.load_loihi(), sanafe.Network()
    source = net.create_neuron_group("input", int(inputs))
    for k, neuron in enumerate(source.neurons):
        spikes = {"spikes": [int(x) for x in pattern[1:-1].split(",")]}
        neuron.set_attributes(soma_hw_name=f"loihi_inputs[{k}]", model_attributes=spikes)
    target = net.create_neuron_group(
        "lif",
        int(size),
        soma_hw_name="loihi_lif",
        default_synapse_hw_name="loihi_dense_synapse",
        model_attributes={"threshold": float(threshold), "leak_decay": 1.0},
    )
    _connect(source, target, np.ones((int(inputs), int(size))))
    simulator = _on_one_core(architecture, net, source, target)
    result = simulator.sim(int(steps))
    counts = ("packets_sent", "neurons_updated", "neurons_fired")
    parts = ("total", "synapse", "dendrite", "soma", "network")
    return {
        "energy": {name: _rounded(result["energy"][name]) for name in parts},
        "sim_time": _rounded(result["sim_time"]),
        "spikes(synops)": result["spikes"],
        **{name: result[name] for name in counts},
    }


def _rounded(value: float) -> float:
    """With five digits; the order of a sum changes the last ones."""
    return float(f"{value:.5g}")


@cache
def _chip() -> Any:  # noqa: ANN401
    """The tool's TrueNorth, whose cores have nothing that plays spikes, with that of its Loihi."""
    shipped = Path(sanafe.__file__).parent / "examples" / "truenorth.yaml"
    text = shipped.read_text().replace("tile[0..4095]", "tile[0]")
    player = """soma:
            - name: inputs[0..255]
              attributes:
                model: input
"""
    prices = ("energy_access_neuron", "latency_access_neuron", "energy_update_neuron",
              "latency_update_neuron", "energy_spike_out", "latency_spike_out")  # fmt: skip
    player += "".join(f"                {name}: 0.0\n" for name in prices)
    with TemporaryDirectory() as folder:
        path = Path(folder) / "truenorth.yaml"
        path.write_text(text.replace("soma:\n", player))
        return sanafe.load_arch(str(path))


def _truenorth(network: dict[str, Any]) -> dict[str, Any]:
    """Membranes and spikes of the network's neurons."""
    weights, raster = np.array(network["weights"]), np.array(network["input"])
    architecture, net = _chip(), sanafe.Network()
    source = net.create_neuron_group("input", len(weights))
    for k, neuron in enumerate(source.neurons):
        spikes = {"spikes": raster[:, k].tolist()}
        neuron.set_attributes(soma_hw_name=f"inputs[{k}]", model_attributes=spikes)
    target = net.create_neuron_group(
        "neurons", weights.shape[1], soma_hw_name="core_soma", log_potential=True, log_spikes=True
    )
    reset = {"zero": "hard", "subtract": "soft"}[network["reset"]]
    for k, neuron in enumerate(target.neurons):
        numbers = {name: float(network[name][k]) for name in ("threshold", "bias", "leak")}
        still = {"reset_mode": reset, "reset": 0.0, "leak_towards_zero": True}
        neuron.set_attributes(
            model_attributes={**numbers, **still, "reverse_reset_mode": "none"},
        )
    _connect(source, target, weights)
    simulator = _on_one_core(architecture, net, source, target)
    result = simulator.sim(len(raster), potential_trace=True, spike_trace=True)
    fired = np.zeros((len(raster), weights.shape[1]), np.int64)
    for row, neurons in enumerate(result["spike_trace"]):
        for neuron in neurons:
            fired[row, neuron.neuron_offset] = 1
    membranes = np.array(result["potential_trace"]).astype(np.int64)
    return {"membrane": membranes.tolist(), "spikes": fired.tolist()}


def _connect(source: Any, target: Any, weights: Any) -> None:  # noqa: ANN401
    """A synapse for each weight (pre, post) that is not 0."""
    pairs = np.argwhere(weights).tolist()
    values = [float(weights[pre, post]) for pre, post in pairs]
    source.connect_neurons_sparse(target, {"weight": values}, [tuple(pair) for pair in pairs])


def _on_one_core(architecture: Any, net: Any, *groups: Any) -> Any:  # noqa: ANN401
    core = architecture.cores()[0]
    for group in groups:
        for neuron in group.neurons:
            neuron.map_to_core(core)
    simulator = sanafe.SpikingChip(architecture)
    simulator.load(net)
    return simulator
