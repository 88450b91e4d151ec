"""Run by the Python of a peer: open files there, run them, write what came of it.

    python peer_process.py PEER < jobs.json

jobs.json is a list of jobs; a line of JSON for each is printed as soon as it is done. A peer need
not have spikedeploy: this file imports the standard library, numpy, nir and the peer. It looks
none of them up before it is asked to.
"""

import contextlib
import json
import os
import sys
import warnings
from collections.abc import Callable
from importlib import import_module
from importlib.metadata import version
from typing import Any

Job = dict[str, Any]
_NEURONS = ("IF", "LIF", "CubaLIF")
# of the packages that decide how a file is read
_PACKAGES = {
    "norse": ("norse", "nirtorch", "nir", "torch"),
    "rockpool": ("rockpool", "nirtorch", "nir", "torch"),
    "snn-mlir": ("snn-mlir", "nir"),
    "snntorch": ("snntorch", "nirtorch", "nir", "torch"),
    "spikingjelly": ("spikingjelly", "nirtorch", "nir", "torch"),
}


def main() -> None:
    """Do the jobs of stdin."""
    peer, answers = sys.argv[1], os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # tools print on stdout when they import
    warnings.simplefilter("ignore")
    for job in json.load(sys.stdin):
        print(json.dumps(done(peer, job)), file=answers, flush=True)


def done(peer: str, job: Job) -> Job:
    """Outcome of a job: its file opens or not, and why; spikes are in the job's `out`.

    `opens` is None where something that the peer needs is not installed.
    """
    kind = "nir" if peer.startswith("nir") else peer
    try:
        return {"opens": True, "message": PEERS[kind](job)}
    except ImportError as error:
        return {"opens": None, "message": str(error)}
    # whatever the tool raises is its answer
    except (Exception, SystemExit) as error:
        said = next(iter(str(error).strip().splitlines()), "")
        return {"opens": False, "message": f"{type(error).__name__}: {said}"}


def packages(peer: str) -> Job:
    """Versions of what a peer reads files with."""
    names = _PACKAGES.get(peer, ("nir",))
    return {name: version(name) for name in names}


def _norse(job: Job) -> str:
    norse, reset = import_module("norse.torch"), import_module("norse.torch.functional.reset")
    method = getattr(reset, "reset_subtract" if job.get("reset") == "subtract" else "reset_value")
    network = norse.from_nir(_graph(job), reset_method=method, ignore_warnings=True)
    return _stepped(network, job)


def _snntorch(job: Job) -> str:
    return _stepped(import_module("snntorch.import_nir").import_from_nir(_graph(job)), job)


def _spikingjelly(job: Job) -> str:
    exchange = import_module("spikingjelly.activation_based.nir_exchange")
    return _stepped(exchange.import_from_nir(_graph(job)), job)


def _rockpool(job: Job) -> str:
    if import_module("importlib.util").find_spec("samna"):
        raise ImportError("samna is installed, whose import runs an installer")
    network = import_module("rockpool.nn.modules.torch.nir").from_nir(_graph(job))
    _recorded(network, job, lambda run, rows: [run(rows[None])])
    return f"its mapper's graph: {type(network.as_graph()).__name__}"


def _checked(job: Job) -> str:
    """The verdict of `snn-mlir check`."""
    said = import_module("io").StringIO()
    with contextlib.redirect_stdout(said):
        code = import_module("snn_mlir._cli").main(["check", job["file"], "--json"])
    report = json.loads(said.getvalue())
    if code:
        raise ValueError(_complaint(report))
    return "check: OK"


def _complaint(report: Any) -> str:  # noqa: ANN401 - the tool's own JSON
    """The first thing that it does not take."""
    found = [
        f"node {node['name']!r}: {finding['message']}"
        for node in report["nodes"]
        for finding in node["findings"]
        if not node["ok"]
    ]
    found += [each["message"] for each in report["graph"] if each["severity"] == "error"]
    return found[0] if found else json.dumps(report)


def _round_trip(job: Job) -> str:
    """Read, write and read again with this release of nir."""
    nir = import_module("nir")
    graph = nir.read(job["file"])
    again = job["out"] + ".nir"
    nir.write(again, graph)
    other = nir.read(again)
    if _parameters(graph) != _parameters(other):
        raise ValueError("a parameter is another after it was written and read again")
    return f"{len(graph.nodes)} nodes, the same after write and read"


def _parameters(graph: Any) -> Job:  # noqa: ANN401 - of any release of nir
    """Values of every array of every node, and the edges."""
    found = {
        f"{name}.{field}": (value.shape, value.tolist())
        for name, node in graph.nodes.items()
        for field, value in vars(node).items()
        if hasattr(value, "tolist")
    }
    return {**found, "edges": sorted(graph.edges)}


def _graph(job: Job) -> Any:  # noqa: ANN401 - nir is not imported before the peer is
    return import_module("nir").read(job["file"])


def _stepped(network: Any, job: Job) -> str:  # noqa: ANN401 - a torch module
    """Run a network that hands its state on, timestep by timestep."""

    def run(call: Callable[..., Any], rows: Any) -> list[Any]:  # noqa: ANN401
        state, outputs = None, []
        for row in rows:
            output, state = call(row[None], state)
            outputs.append(output)
        return outputs

    return _recorded(network, job, run)


def _recorded(network: Any, job: Job, run: Callable[..., list[Any]]) -> str:  # noqa: ANN401
    """Write output and spikes of each layer, (T, N), to the job's `out`."""
    np, torch = import_module("numpy"), import_module("torch")
    kinds = {name: type(node).__name__ for name, node in _graph(job).nodes.items()}
    seen: dict[str, list[Any]] = {name: [] for name, kind in kinds.items() if kind in _NEURONS}
    modules = dict(network.named_modules())
    for name, rows in seen.items():
        # torch takes no dots in names
        _listen(modules[name.replace(".", "_")], rows)
    with torch.no_grad():
        raster = torch.from_numpy(np.load(job["raster"]).astype(np.float32))
        seen["output"] = [_values(output) for output in run(network, raster)]
    np.savez(job["out"], **{name: np.concatenate(rows) for name, rows in seen.items()})
    return ""


def _listen(module: Any, rows: list[Any]) -> None:  # noqa: ANN401
    module.register_forward_hook(lambda _, inputs, output: rows.append(_values(output)))


def _values(output: Any) -> Any:  # noqa: ANN401
    """Rows (T, N) of an output with a batch of one, and of a tuple its first."""
    first = output[0] if isinstance(output, tuple) else output
    values = first.detach().numpy()
    return values.reshape(-1, values.shape[-1]).copy()


PEERS: dict[str, Callable[[Job], str]] = {
    "nir": _round_trip,
    "norse": _norse,
    "rockpool": _rockpool,
    "snn-mlir": _checked,
    "snntorch": _snntorch,
    "spikingjelly": _spikingjelly,
}


if __name__ == "__main__":
    if sys.argv[2:] == ["versions"]:
        print(json.dumps(packages(sys.argv[1])))
    else:
        main()
