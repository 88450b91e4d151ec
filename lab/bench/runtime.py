"""How fast programs run, against other libraries on the same networks, and how far the limit is.

    python -m lab runtime [--rounds 15] [--json]

One process, one thread. Candidates take turns, round by round, and the medians of their inferences
are compared: a ratio is a library's time over ours, of the same run. Inputs are spikes, ready in
the form that each takes; a state is reset before every inference; ours keeps no ledger. Libraries
that are not installed are left out, with a line. xylosim's rates are not matched, and SpikingJelly
computes neurons without a synaptic current, which is less than ours.

Two tables follow. `10 x wider`: hidden layers get nine silent neurons for each that there is, so
that as many spikes reach ten times as many neurons. `memory`: the bytes that an inference of the
compiled kernels touches, and how long that takes at the speed at which this machine copies memory
that fits its caches, or does not.
"""

import timeit
from collections.abc import Callable
from importlib.util import find_spec
from typing import Any

import numpy as np
import torch

from lab.bench.nets import Net, Raster, bernoulli, encode, kart, popsan, widen
from lab.bench.peers import peers
from lab.bench.turns import Act, medians, parser_of, report
from spikedeploy.runtime.emulator.interpreter import trace
from spikedeploy.runtime.emulator.machine import Machine

INPUTS = 20  # rasters of a round at batch 1
Times = dict[str, float]


def main() -> None:
    """Measure, and print tables or JSON."""
    arguments = parser_of(__doc__).parse_args()
    torch.set_num_threads(1)
    rounds, population = arguments.rounds, encode(1024, 5)
    rasters = {"popsan": bernoulli(32, 5, 770, 0.2), "encoded": population}
    rasters["kart"] = bernoulli(32, 32, 20, 0.3)
    nets = {name: (kart if name == "kart" else popsan)(raster) for name, raster in rasters.items()}
    few = {name: raster[:INPUTS] for name, raster in rasters.items()}
    result = {
        "popsan, batch 1": compare(nets["popsan"], few["popsan"], 1, rounds),
        "popsan with its encoder, batch 1": compare(nets["encoded"], few["encoded"], 1, rounds),
        "popsan with its encoder, batch 1024": compare(nets["encoded"], population, 1024, rounds),
        "kart, batch 1": compare(nets["kart"], few["kart"], 1, rounds),
        "10 x wider": {name: scaling(nets[name], few[name], rounds) for name in ("kart", "popsan")},
    }
    result["memory"] = {
        "copies_GB_per_s": (speeds := {name: copying(size) for name, size in SIZES.items()}),
        "per_inference": {name: memory(nets[name], few[name], speeds) for name in nets},
    }
    report(result, arguments, table)


def compare(net: Net, raster: Raster, batch: int, rounds: int) -> dict[str, Any]:
    """Medians of all candidates [us per inference], and ratios to ours."""
    rasters = [raster[at : at + batch] for at in range(0, len(raster), batch)]
    candidates = {name: calls(run, rasters) for name, run in ours(net, batch).items()}
    missing = {} if find_spec("numba") else {"numba": "is not installed"}
    for name, peer in peers(net, batch):
        if isinstance(peer, str):
            missing[name] = peer
        else:
            candidates[name] = calls(peer.run, [peer.prepare(one) for one in rasters])
    median = {name: taken / batch for name, taken in medians(candidates, rounds).items()}
    return {
        "median_us": median,
        "ratios": {
            mine: {name: median[name] / median[mine] for name in median if name not in OURS}
            for mine in OURS
            if mine in median
        },
        "missing": missing,
        "agreement": agreement(net, raster[:8]),
    }


OURS = ("numpy", "numba")


def ours(net: Net, batch: int) -> dict[str, Callable[[Raster], Any]]:
    """Our machines for a batch; larger ones come in the chunks that pools cut."""
    size = 1 if batch == 1 else None
    return {
        name: Machine(net.program, size, "none", backend=name).infer
        for name in OURS
        if name == "numpy" or find_spec("numba")
    }


def calls(run: Callable[[Any], Any], inputs: list[Any]) -> list[Act]:
    """One call for each input."""
    return [lambda one=one: run(one) for one in inputs]


def agreement(net: Net, raster: Raster) -> dict[str, float]:
    """Share of the last layer's neurons that spike as often as in the specification.

    xylosim has another arithmetic, and SpikingJelly's neurons are the same without a current only.
    """
    expected = trace(net.program, raster)[net.program.output].spikes.sum(axis=1)
    found = {name: run(raster).sum(axis=1) for name, run in ours(net, len(raster)).items()}
    for name, peer in peers(net, len(raster)):
        if not isinstance(peer, str) and not (name == "spikingjelly" and net.alpha):
            found[name] = peer.run(peer.prepare(raster)).sum(dim=0).numpy()
    return {name: float((counts == expected).mean()) for name, counts in found.items()}


def scaling(net: Net, raster: Raster, rounds: int) -> dict[str, Any]:
    """Medians [us] of a network and of its wide twin, which spikes as often."""
    wide = widen(net, 10)
    candidates, spikes = {}, {}
    for name, one in (("narrow", net), ("wide", wide)):
        traces = trace(one.program, raster)
        spikes[name] = [int(raster.sum()), *(int(t.spikes.sum()) for t in traces.values())]
        for mine, run in ours(one, 1).items():
            candidates[f"{mine} {name}"] = calls(run, [raster[k : k + 1] for k in range(INPUTS)])
    if spikes["narrow"] != spikes["wide"]:
        raise AssertionError(f"the twins spike differently: {spikes}")
    median = medians(candidates, rounds)
    names = [name.removesuffix(" narrow") for name in candidates if name.endswith("narrow")]
    return {
        "median_us": median,
        "ratios": {name: median[f"{name} wide"] / median[f"{name} narrow"] for name in names},
    }


def memory(net: Net, raster: Raster, speeds: Times) -> Times:
    """Bytes that an inference of the compiled kernels touches, and how long that takes at least."""
    traces = trace(net.program, raster)
    presynaptic = [raster, *(traces[a.name].spikes for a in net.program.layers)][: len(net.weights)]
    spikes = [float(rows.sum()) / len(raster) for rows in presynaptic]
    # these weights fit 8 bits
    weights = sum(n * w.shape[1] for n, w in zip(spikes, net.weights, strict=True))
    neurons = sum(w.shape[1] for w in net.weights) * net.timesteps * NEURON_BYTES
    lasts = {f"us_at_{at}": 1e-3 * (weights + neurons) / speed for at, speed in speeds.items()}
    return {"weights_kB": weights / 1e3, "neurons_kB": neurons / 1e3, **lasts}


# of an update: two states of 8 bytes read and written, four constants of 4, the sum, the spike and
# its place in the list
NEURON_BYTES = 2 * 2 * 8 + 4 * 4 + 2 + 1 + 4
SIZES = {"L2": 200_000, "L3": 4_000_000, "DRAM": 200_000_000}


def copying(size: int) -> float:
    """Bytes read and written in a nanosecond, from memory of this size."""
    source, target = np.ones(size, np.uint8), np.ones(size, np.uint8)
    return (
        2 * size / min(timeit.repeat(lambda: np.copyto(target, source), number=1, repeat=20)) / 1e9
    )


def table(result: dict[str, Any]) -> str:
    """Return the result for people."""
    lines = ["one thread, medians of one run; times are us per inference"]
    for title, part in result.items():
        lines += ["", title]
        if title == "10 x wider":
            for name, net in part.items():
                for mine, ratio in net["ratios"].items():
                    both = [net["median_us"][f"{mine} {width}"] for width in ("narrow", "wide")]
                    lines.append(f"  {name:8} {mine:8} {both[0]:9.1f} {both[1]:9.1f} x{ratio:.2f}")
        elif title == "memory":
            lines.append("  copies, GB/s: " + row(part["copies_GB_per_s"]))
            lines += [f"  {name:8} {row(values)}" for name, values in part["per_inference"].items()]
        else:
            for name, taken in part["median_us"].items():
                ratios = [
                    f"{of[name]:7.1f} x {m}" for m, of in part["ratios"].items() if name in of
                ]
                lines.append(f"  {name:13}{taken:10.1f}  {' '.join(ratios)}")
            lines += [f"  {name:13} {why}" for name, why in part["missing"].items()]
            lines.append("  spikes as the specification: " + row(part["agreement"]))
    return "\n".join(lines)


def row(values: dict[str, float]) -> str:
    """Names and numbers in a line."""
    return ", ".join(f"{name} {value:.3g}" for name, value in values.items())
