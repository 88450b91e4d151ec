"""How fast programs run, against other libraries on the same networks.

    python -m lab runtime [--rounds 15] [--json]

One process, one thread. Candidates take turns, round by round, and the medians of their inferences
are compared: a ratio is a library's time over ours, of the same run. Inputs are spikes, ready in
the form that each takes; a state is reset before every inference; ours keeps no ledger. Libraries
that are not installed are left out, with a line. xylosim's rates are not matched, and SpikingJelly
computes neurons without a synaptic current, which is less than ours.
"""

from collections.abc import Callable
from importlib.util import find_spec
from typing import Any

import torch

from lab.bench.nets import Net, Raster, bernoulli, encode, kart, popsan
from lab.bench.peers import peers
from lab.bench.turns import Act, medians, parser_of, report
from spikedeploy.runtime.emulator.interpreter import trace
from spikedeploy.runtime.emulator.machine import Machine

INPUTS = 20  # rasters of a round at batch 1


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
    }
    report(result, arguments)


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
