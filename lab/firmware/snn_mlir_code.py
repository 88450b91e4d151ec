"""Networks through snn-mlir and LLVM 22 to object files, and what calls them."""

import re
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lab.firmware.snn_to_linalg import lowered
from lab.firmware.targets import SOURCES, counted, must, piped, shared

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
_ARM = {"cortex-m4": _SOFT, "cortex-m4f": ("-float-abi=hard",)}


class Tools(NamedTuple):
    """A Python that has snn-mlir, the programs of LLVM 22, and a snn-opt or None."""

    python: Path
    llvm: Path
    snn_opt: Path | None


def write(tools: Tools, network: Path, kind: str, raster: NDArray[np.uint8], folder: Path) -> None:
    """Fill a folder: network.mlir without snn, policy.h, vectors.h and mlir_net.c."""
    # isolated (-I): what this process imports from is nothing to that Python
    code = f"import snn_mlir; print(snn_mlir.to_mlir({str(network)!r}, quantize={kind == 'int8'}))"
    text = piped([str(tools.python), "-I", "-c", code])
    if tools.snn_opt:
        plain = piped([str(tools.snn_opt), "-", "--convert-snn-to-linalg"], text)
    else:
        plain = lowered(text)
    (folder / "network.mlir").write_text(plain)
    found = re.findall(r"^\s*(%\w+) : memref<(\d+)x\w+>", text, re.MULTILINE)
    *states, output = [int(size) for _, size in found[1:]]
    write_header(folder, raster, output, _ELEMENT[kind])
    (folder / "mlir_net.c").write_text(_caller(states, output, kind))


def write_header(folder: Path, raster: NDArray[np.uint8], outputs: int, element: str) -> None:
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


def built(tools: Tools, target: str, folder: Path) -> dict:
    """What it takes of a microcontroller."""
    triple = ("-mtriple=thumbv7em-none-eabi", "-mcpu=cortex-m4", *_ARM[target])
    _object(tools, folder, 32, "-O2", triple)
    return counted(target, folder, ("mlir_net.c", "net.o"))


def host(tools: Tools, folder: Path) -> None:
    """A shared object for this machine."""
    triple = must(["gcc", "-dumpmachine"], folder).strip()
    options = (f"-mtriple={triple}", "-mcpu=native", "--relocation-model=pic")
    _object(tools, folder, 64, "-O3", options)
    shared(folder, "mlir_net.c", "net.o")


def _object(tools: Tools, folder: Path, index: int, level: str, options: tuple[str, ...]) -> None:
    passes = [f"-{x}=index-bitwidth={index}" if x in _WIDE else f"-{x}" for x in _PASSES]
    llvm = tools.llvm
    lower = [str(llvm / "mlir-opt"), *passes, str(folder / "network.mlir")]
    code = piped([str(llvm / "mlir-translate"), "--mlir-to-llvmir"], piped(lower))
    triple = [word for word in options if word.startswith("-m")]
    code = piped([str(llvm / "opt"), level, *triple, "-S"], code)
    out = ["-filetype=obj", "-", "-o", str(folder / "net.o")]
    piped([str(llvm / "llc"), level, *options, *out], code)


def _caller(states: list[int], output: int, kind: str) -> str:
    """C that plays a raster from zero states, as the main.c of snn-mlir plays its input."""
    text = (SOURCES / "mlir_net.c").read_text()
    count = len(states)
    fields = "".join(f"    {_STATE[kind]} s{k}[{size}];\n" for k, size in enumerate(states))
    made = "".join(
        f"    memref_t d{k} = {{state.s{k}, state.s{k}, 0, {size}, 1}};\n"
        for k, size in enumerate(states)
    )
    gaps = {
        "@ELEMENT@": _ELEMENT[kind],
        "@FIELDS@": fields,
        "@MEMREFS@": made,
        "@POINTERS@": ", ".join(["memref_t *"] * (count + 2)),
        "@STATES@": "".join(f"&d{k}, " for k in range(count)),
        "@OUTPUT@": str(output),
    }
    for gap, value in gaps.items():
        text = text.replace(gap, value)
    return text
