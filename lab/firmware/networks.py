r"""Spiking networks as C beside snn-mlir's: code, instructions and time of an inference.

    python -m lab firmware-networks --snn-mlir VENV/bin/python --llvm /usr/lib/llvm-22/bin

The spiking layers of two shipped policies, which both tools take: without encoder, and without the
last affine map, whose result snn-mlir 1.0.0 computes and writes nowhere. All play the same rasters,
a byte or a float for each input and timestep; outputs are spike counts. Ours is C of loihi1. That
of snn-mlir is float32, or 8-bit weights with states of 32 bits (`-q`); it goes through the passes
of `snn-mlir run`, then LLVM's own optimiser, which that leaves out, then the same linker.

snn-mlir needs LLVM 22 (Debian has it: llvm-22, mlir-22-tools) and snn-opt, a program that is in no
package; lab/firmware/snn_to_linalg.py stands in for it, or give your own by --snn-opt.

--write puts the table into docs/firmware.md. Exits with 1 where spikes of ours or of snn-mlir's
float32 are not those of the network.
"""

import argparse
import ctypes
import json
import sys
import tempfile
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import nir
import numpy as np
from numpy.typing import NDArray

from lab.firmware import dense, snn_mlir_code
from lab.firmware.runs import best, in_turns
from lab.firmware.table import NETWORKS, network_table, put
from lab.firmware.targets import BESIDE, SOURCES, counted, shared
from spikedeploy import zoo
from spikedeploy.exporters.c.to_c import network_in_c
from spikedeploy.exporters.c.to_c import write as write_c
from spikedeploy.runtime.artifact.artifact import Artifact, load, save
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.compiler.compile import compile_program, own_clock
from spikedeploy.runtime.emulator.interpreter import trace
from spikedeploy.runtime.float_model import FloatGraph
from spikedeploy.shipping.export_c import export_c

NAMES = ("kart-grid/snn", "hexapod/popsan")
_MOST = 4096  # outputs


def main() -> None:
    """Measure the networks and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--snn-mlir", type=Path, required=True, help="a Python that has snn-mlir")
    parser.add_argument("--llvm", type=Path, required=True, help="the programs of LLVM 22")
    parser.add_argument("--snn-opt", type=Path, help="a snn-opt of your own")
    parser.add_argument("--only", default="", help="a policy, such as kart-grid/snn")
    parser.add_argument("--write", action="store_true", help="the table into docs/firmware.md")
    options = parser.parse_args()
    tools = snn_mlir_code.Tools(options.snn_mlir, options.llvm, options.snn_opt)
    rows = []
    for name in NAMES:
        if options.only in ("", name):
            with tempfile.TemporaryDirectory() as folder:
                rows += _network(name, tools, Path(folder))
    print(network_table(rows))
    if options.write:
        put(NETWORKS, network_table(rows))
    sys.exit(any(row["differ"] for row in rows))


def _network(name: str, tools: snn_mlir_code.Tools, folder: Path) -> list[dict]:
    """Rows of a network: ours, then snn-mlir's of both kinds."""
    policy = load(zoo.path(name))
    export_c(name, "loihi1", folder / "policy")
    observations = dense.recorded(folder / "policy")
    raster = np.asarray(policy.codec.encode_episode(observations))
    spiking = without_readout(policy)
    save(spiking, folder / "net.nir")
    program = compile_program(spiking, chip("loihi1"), clock=own_clock(spiking.convention))
    wanted = {"own": trace(program, raster)[program.output].spikes.sum(axis=1)}
    wanted["float32"] = FloatGraph(spiking).run(raster)["output"].sum(axis=1).astype(np.int64)
    rows = [_own(name, program, raster, folder / "own")]
    for kind in snn_mlir_code.KINDS:
        rows.append({"policy": name, "by": f"snn-mlir, {kind}", "kind": kind})
        place = folder / kind
        place.mkdir()
        snn_mlir_code.write(tools, folder / "net.nir", kind, raster, place)
        rows[-1] |= {target: snn_mlir_code.built(tools, target, place) for target in BESIDE}
        snn_mlir_code.host(tools, place)
    for row in rows:
        found = _counts(folder / row["kind"], raster, wanted["float32"].shape[1])
        row["unlike"] = int((found != wanted["float32"]).sum())
        row["counts"] = found.size
        # 8-bit weights of snn-mlir have nothing here to be compared with exactly
        own = wanted.get(row["kind"], found)
        row["differ"] = int((found != own).sum())
        print(json.dumps(row), file=sys.stderr, flush=True)
    in_turns(rows, lambda row: _inference_ns(folder / row["kind"], raster))
    return rows


def without_readout(policy: Artifact) -> Artifact:
    """The network up to its last spiking layer, whose spikes are the output."""
    graph = policy.graph
    last = next(source for source, target in graph.edges if target == "readout")
    nodes = {name: node for name, node in graph.nodes.items() if name != "readout"}
    size = graph.nodes[last].v_threshold.shape
    nodes["output"] = nir.Output(np.array(size))
    edges = [edge for edge in graph.edges if "readout" not in edge]
    return replace(policy, graph=nir.NIRGraph(nodes, [*edges, (last, "output")]), codec=None)


def _own(name: str, program, raster: NDArray[np.uint8], folder: Path) -> dict:  # noqa: ANN001
    write_c(network_in_c(program, raster, name, prefix="net"), folder)
    snn_mlir_code.write_header(folder, raster, program.layer(program.output).size, "int8_t")
    (folder / "net_counts.c").write_bytes((SOURCES / "net_counts.c").read_bytes())
    sources = ("net.c", "net_counts.c")
    shared(folder, *sources)
    found = {target: counted(target, folder, sources) for target in BESIDE}
    return {"policy": name, "by": "spikedeploy, loihi1", "kind": "own", **found}


def _counts(folder: Path, raster: NDArray[np.uint8], outputs: int) -> NDArray[np.int64]:
    """(S, N) spikes of each output neuron in each inference."""
    step, places, _ = _played(folder, raster)
    action, found = (ctypes.c_int32 * outputs)(), []
    for place in places:
        step(place, action)
        found.append(list(action))
    return np.array(found)


def _played(folder: Path, raster: NDArray[np.uint8]) -> tuple:
    """The C that plays a raster, the address of each inference's, and the memory that these are."""
    kept = raster.reshape(len(raster), -1)
    kept = kept.astype(np.float32 if folder.name == "float32" else np.int8)
    places = [row.ctypes.data_as(ctypes.c_void_p) for row in kept]
    return ctypes.CDLL(str(folder / "timed.so")).policy_step, places, kept


def _inference_ns(folder: Path, raster: NDArray[np.uint8]) -> float:
    step, places, _kept = _played(folder, raster)
    action = (ctypes.c_int32 * _MOST)()
    return 1e9 * best(partial(_all, step, places, action)) / len(places)


def _all(step: Callable, places: list, action: ctypes.Array) -> None:
    for place in places:
        step(place, action)
