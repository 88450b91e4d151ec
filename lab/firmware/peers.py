r"""Spiking policies as C beside dense ones through emlearn: memory, instructions and time.

    python -m lab firmware-peers --emlearn VENV/bin/python [--only hexapod] [--write]

For each task the shipped spiking policies are exported as `spikedeploy export --to c --chip loihi1`
does it, and the shipped dense ones, float teachers and baselines, are written as C by emlearn. Both
are built by the same compiler with the same options and run on the same observations. Needs what
lab/firmware/policies.py needs, all of it, and a Python in which emlearn is installed:

    python -m venv VENV && VENV/bin/pip install emlearn

--write puts the table into results/firmware.md. Exits with 1 where C of emlearn differs from ONNX.
"""

import ctypes
import json
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lab.firmware import dense
from lab.firmware.table import PEERS, options_of, publish
from lab.firmware.targets import BESIDE, SOURCES, best, build_shared, count_instructions, in_turns
from spikedeploy import zoo
from spikedeploy.policies.onnx import OnnxController
from spikedeploy.shipping.export_c import export_c

_TOLERANCE = 2e-5  # of actions, between float32 of emlearn and of ONNX Runtime


def main() -> None:
    """Measure the policies of each task and print the table."""
    parser = options_of(__doc__, "a task, such as hexapod")
    parser.add_argument("--emlearn", type=Path, required=True, help="a Python that has emlearn")
    options = parser.parse_args()
    rows = []
    for task in dict.fromkeys(name.split("/")[0] for name in zoo.names()):
        if options.only in ("", task) and task != "kart-eye":  # C encodes no counts of events
            with tempfile.TemporaryDirectory() as folder:
                rows += _task(task, options.emlearn, Path(folder))
    publish(options, rows, PEERS)
    sys.exit(any(row["error"] > _TOLERANCE for row in rows))


def _task(task: str, python: Path, folder: Path) -> list[dict]:
    """Rows of a task, the spiking policies first."""
    names = [name for name in zoo.names() if name.startswith(f"{task}/")]
    spiking = [name for name in names if zoo.path(name).suffix == ".nir"]
    rows = [_spiking(name, folder / name) for name in sorted(spiking, reverse=True)]
    seen = dense.read_observations(folder / spiking[0])
    for name in names:
        if name not in spiking:
            rows += _dense(name, seen, python, folder / name)
    in_turns(rows, lambda row: _step_ns(seen, folder / row["policy"], row["by"] == "spikedeploy"))
    return rows


def _spiking(name: str, folder: Path) -> dict:
    folder.mkdir(parents=True)
    export_c(name, folder, chip="loihi1")
    row = {"policy": name, "by": "spikedeploy", "error": 0.0}
    return row | _built(name, folder, ("policy.c", "codec.c"))


def _dense(name: str, seen: NDArray[np.float64], python: Path, folder: Path) -> Iterator[dict]:
    """The row of a dense policy, if it is one."""
    policy = dense.read(zoo.path(name))
    if policy is None:
        return
    folder.mkdir(parents=True)
    release = dense.write(policy, python, seen, folder)
    row = {"policy": name, "by": f"emlearn {release}"}
    row |= _built(name, folder, ("dense.c",))
    yield row | {"error": _error(name, seen, folder, policy.chooses)}


def _built(name: str, folder: Path, sources: tuple[str, ...]) -> dict:
    """Numbers that are measured alike of all policies."""
    build_shared(folder, *sources, str(SOURCES / "repeat.c"))
    found = {target: count_instructions(target, folder, sources) for target in BESIDE}
    print(name, json.dumps(found), file=sys.stderr, flush=True)
    return {"return": zoo.mean_return(zoo.card(name)), **found}


def _error(name: str, seen: NDArray[np.float64], folder: Path, chooses: bool) -> float:
    """How far actions of emlearn's C are from those of ONNX Runtime, at most; choices: which part.

    ONNX Runtime is what `spikedeploy run` plays these policies with.
    """
    wanted = np.asarray(OnnxController(zoo.path(name)).replay(seen)).reshape(len(seen), -1)
    loaded = ctypes.CDLL(str(folder / "timed.so"))
    action = ((ctypes.c_int32 if chooses else ctypes.c_float) * wanted.shape[1])()
    found = []
    for row in seen.astype(np.float32):
        loaded.policy_step(row.ctypes.data_as(ctypes.c_void_p), action)
        found.append(list(action))
    if chooses:
        return float((np.array(found) != wanted).mean())
    return float(np.abs(np.array(found) - wanted).max())


def _step_ns(seen: NDArray[np.float64], folder: Path, own: bool) -> float:
    loaded = ctypes.CDLL(str(folder / "timed.so"))
    rows = np.tile(seen.astype(np.float64 if own else np.float32), (50, 1))
    place, action = rows.ctypes.data_as(ctypes.c_void_p), (ctypes.c_double * 64)()
    spent = best(lambda: loaded.repeat(place, ctypes.c_uint32(len(rows)), action))
    return 1e9 * spent / len(rows)
