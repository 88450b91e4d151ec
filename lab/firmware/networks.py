r"""Spiking networks as C beside snn-mlir's: code, instructions and time of an inference.

    python -m lab firmware-networks --snn-mlir VENV/bin/python --llvm /usr/lib/llvm-22/bin

The spiking layers of two shipped policies, which both tools take: without encoder, and without the
last affine map, whose result snn-mlir 1.0.0 computes and writes nowhere. All play the same rasters,
a byte or a float for each input and timestep; outputs are spike counts. Ours is C of loihi1. That
of snn-mlir is float32, or 8-bit weights with states of 32 bits (`-q`); it goes through the passes
of `snn-mlir run`, then LLVM's own optimiser, which that leaves out, then the same linker.

snn-mlir needs LLVM 22 (Debian has it: llvm-22, mlir-22-tools) and snn-opt, a program that is in no
package; lab/firmware/snn_to_linalg.py stands in for it, or give your own by --snn-opt.

--write puts the table into results/firmware.md. Exits with 1 where spikes of ours or of snn-mlir's
float32 are not those of the network.
"""

import ctypes
import json
import re
import sys
import tempfile
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import nir
import numpy as np
from numpy.typing import NDArray

from lab.firmware import dense
from lab.firmware.snn_to_linalg import lower
from lab.firmware.table import NETWORKS, options_of, publish
from lab.firmware.targets import (
    BESIDE,
    SOURCES,
    best,
    build_shared,
    count_instructions,
    in_turns,
    pipe,
    run,
)
from spikedeploy import zoo
from spikedeploy.exporters.c.packaging import write_texts
from spikedeploy.exporters.c.to_c import network_in_c
from spikedeploy.runtime.artifact.artifact import Artifact, load, save
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.compiler.compile import compile_program, own_clock
from spikedeploy.runtime.emulator.interpreter import trace
from spikedeploy.runtime.float_model import FloatGraph
from spikedeploy.shipping.export_c import export_c

NAMES = ("kart-grid/snn", "hexapod/popsan")
_MOST = 4096  # outputs
KINDS = ("float32", "int8")
_ELEMENT = {"float32": "float", "int8": "int8_t"}
_STATE = {"float32": "float", "int8": "int32_t"}
# as `snn-mlir run` has them; those that take it are told the width of an index
_PASSES = (
    "convert-linalg-to-affine-loops", "affine-loop-invariant-code-motion", "affine-scalrep", "cse",
    "canonicalize", "lower-affine", "convert-scf-to-cf", "convert-func-to-llvm",
    "convert-cf-to-llvm", "finalize-memref-to-llvm", "convert-arith-to-llvm",
    "reconcile-unrealized-casts", "canonicalize",
)  # fmt: skip
_WIDE = {"convert-func-to-llvm", "convert-cf-to-llvm", "finalize-memref-to-llvm"}
_WIDE |= {"convert-arith-to-llvm"}
_SOFT = ("-mattr=-fpregs", "-float-abi=soft")
_FLOAT_ABI = {"cortex-m4": _SOFT, "cortex-m4f": ("-float-abi=hard",)}


class Tools(NamedTuple):
    """A Python that has snn-mlir, the programs of LLVM 22, and a snn-opt or None."""

    python: Path
    llvm: Path
    snn_opt: Path | None


def main() -> None:
    """Measure the networks and print the table."""
    parser = options_of(__doc__, "a policy, such as kart-grid/snn")
    parser.add_argument("--snn-mlir", type=Path, required=True, help="a Python that has snn-mlir")
    parser.add_argument("--llvm", type=Path, required=True, help="the programs of LLVM 22")
    parser.add_argument("--snn-opt", type=Path, help="a snn-opt of your own")
    options = parser.parse_args()
    tools = Tools(options.snn_mlir, options.llvm, options.snn_opt)
    rows = []
    for name in NAMES:
        if options.only in ("", name):
            with tempfile.TemporaryDirectory() as folder:
                rows += _network(name, tools, Path(folder))
    publish(options, rows, NETWORKS)
    sys.exit(any(row["differ"] for row in rows))


def _network(name: str, tools: Tools, folder: Path) -> list[dict]:
    """Rows of a network: ours, then snn-mlir's of both kinds."""
    policy = load(zoo.path(name))
    export_c(name, folder / "policy", chip="loihi1")
    observations = dense.read_observations(folder / "policy")
    raster = np.asarray(policy.codec.encode_episode(observations))
    spiking = without_readout(policy)
    save(spiking, folder / "net.nir")
    program = compile_program(spiking, chip("loihi1"), clock=own_clock(spiking.convention))
    wanted = {"own": trace(program, raster)[program.output].spikes.sum(axis=1)}
    wanted["float32"] = FloatGraph(spiking).run(raster)["output"].sum(axis=1).astype(np.int64)
    rows = [_own(name, program, raster, folder / "own")]
    for kind in KINDS:
        rows.append({"policy": name, "by": f"snn-mlir, {kind}", "kind": kind})
        place = folder / kind
        place.mkdir()
        _write_mlir(tools, folder / "net.nir", kind, raster, place)
        rows[-1] |= {target: _built(tools, target, place) for target in BESIDE}
        triple = run(["gcc", "-dumpmachine"], place).strip()
        native = (f"-mtriple={triple}", "-mcpu=native", "--relocation-model=pic")
        _object(tools.llvm, place, 64, "-O3", native)
        build_shared(place, "mlir_net.c", "net.o")
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
    write_texts(network_in_c(program, raster, name, prefix="net").text, folder)
    _write_header(folder, raster, program.layer(program.output).size, "int8_t")
    (folder / "net_counts.c").write_bytes((SOURCES / "net_counts.c").read_bytes())
    sources = ("net.c", "net_counts.c")
    build_shared(folder, *sources)
    found = {target: count_instructions(target, folder, sources) for target in BESIDE}
    return {"policy": name, "by": "spikedeploy, loihi1", "kind": "own", **found}


def _played(folder: Path, raster: NDArray[np.uint8]) -> Callable[[ctypes.Array], Iterator[None]]:
    """The C that plays a raster into an array of spike counts, inference by inference."""
    kept = raster.reshape(len(raster), -1)
    kept = kept.astype(np.float32 if folder.name == "float32" else np.int8)
    places = [row.ctypes.data_as(ctypes.c_void_p) for row in kept]
    step = ctypes.CDLL(str(folder / "timed.so")).policy_step

    def play(action: ctypes.Array) -> Iterator[None]:
        for place, _ in zip(places, kept, strict=True):  # which must outlive its address
            step(place, action)
            yield

    return play


def _counts(folder: Path, raster: NDArray[np.uint8], outputs: int) -> NDArray[np.int64]:
    """(S, N) spikes of each output neuron in each inference."""
    action = (ctypes.c_int32 * outputs)()
    return np.array([list(action) for _ in _played(folder, raster)(action)])


def _inference_ns(folder: Path, raster: NDArray[np.uint8]) -> float:
    play, action = _played(folder, raster), (ctypes.c_int32 * _MOST)()
    return 1e9 * best(lambda: deque(play(action), 0)) / len(raster)


# through snn-mlir and LLVM


def _write_mlir(
    tools: Tools, network: Path, kind: str, raster: NDArray[np.uint8], folder: Path
) -> None:
    """Fill a folder: network.mlir without snn, policy.h, vectors.h and mlir_net.c."""
    # isolated (-I): what this process imports from is nothing to that Python
    code = f"import snn_mlir; print(snn_mlir.to_mlir({str(network)!r}, quantize={kind == 'int8'}))"
    text = pipe([str(tools.python), "-I", "-c", code])
    if tools.snn_opt:
        plain = pipe([str(tools.snn_opt), "-", "--convert-snn-to-linalg"], text)
    else:
        plain = lower(text)
    (folder / "network.mlir").write_text(plain)
    found = re.findall(r"^\s*(%\w+) : memref<(\d+)x\w+>", text, re.MULTILINE)
    *states, output = [int(size) for _, size in found[1:]]
    _write_header(folder, raster, output, _ELEMENT[kind])
    (folder / "mlir_net.c").write_text(_caller(states, output, kind))


def _write_header(folder: Path, raster: NDArray[np.uint8], outputs: int, element: str) -> None:
    """policy.h and vectors.h of a network that is given rasters."""
    inferences, timesteps, width = raster.shape
    (folder / "policy.h").write_text(f"""#include <stdint.h>
#define POLICY_STEPS {timesteps}
#define POLICY_WIDTH {width}
#define POLICY_OBSERVATIONS (POLICY_STEPS * POLICY_WIDTH)
#define POLICY_ACTIONS {outputs}
#define OBSERVATION {element}
typedef int32_t policy_action_t;
void policy_reset(void);
int policy_step(const OBSERVATION *raster, policy_action_t *counts);
""")
    numbers = ",".join(map(str, raster.ravel().tolist()))
    (folder / "vectors.h").write_text(f"""#include <stdint.h>
#define VECTOR_INFERENCES {inferences}u
static const {element} vector_observation[] = {{{numbers}}};
""")


def _built(tools: Tools, target: str, folder: Path) -> dict:
    """Demands on a microcontroller."""
    triple = ("-mtriple=thumbv7em-none-eabi", "-mcpu=cortex-m4", *_FLOAT_ABI[target])
    _object(tools.llvm, folder, 32, "-O2", triple)
    return count_instructions(target, folder, ("mlir_net.c", "net.o"))


def _object(llvm: Path, folder: Path, index: int, level: str, options: tuple[str, ...]) -> None:
    passes = [f"-{x}=index-bitwidth={index}" if x in _WIDE else f"-{x}" for x in _PASSES]
    code = pipe([str(llvm / "mlir-opt"), *passes, str(folder / "network.mlir")])
    code = pipe([str(llvm / "mlir-translate"), "--mlir-to-llvmir"], code)
    triple = [word for word in options if word.startswith("-m")]
    code = pipe([str(llvm / "opt"), level, *triple, "-S"], code)
    out = ["-filetype=obj", "-", "-o", str(folder / "net.o")]
    pipe([str(llvm / "llc"), level, *options, *out], code)


def _caller(states: list[int], output: int, kind: str) -> str:
    """C that plays a raster from zero states, as the main.c of snn-mlir plays its input."""
    gaps = {
        "ELEMENT": _ELEMENT[kind],
        "FIELDS": "".join(f"    {_STATE[kind]} s{k}[{n}];\n" for k, n in enumerate(states)),
        "MEMREFS": "".join(
            f"    memref_t d{k} = {{state.s{k}, state.s{k}, 0, {n}, 1}};\n"
            for k, n in enumerate(states)
        ),
        "POINTERS": ", ".join(["memref_t *"] * (len(states) + 2)),
        "STATES": "".join(f"&d{k}, " for k in range(len(states))),
        "OUTPUT": str(output),
    }
    text = (SOURCES / "mlir_net.c").read_text()
    return re.sub(r"@([A-Z]+)@", lambda found: gaps[found[1]], text)
