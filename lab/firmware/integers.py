r"""Sparse spiking policies beside dense ones in 8-bit weights: instructions, memory, returns.

    python -m lab firmware-integers --emlearn VENV/bin/python [--episodes 20] [--write]

Each policy is exported as `spikedeploy export --to c` does it: sparse ones on loihi1 with both of
their interfaces, dense ones in 8-bit weights; dense ones in float are written by emlearn. All are
built by the same compiler with the same options, and run on the same 200 observations under qemu,
for five cores. Returns are those of the C, as a shared object in the environment, on the same
seeds; those of float networks are ONNX Runtime's. Needs what lab/firmware/peers.py needs.

--rows keeps what is measured in a file, a line each, from which a later call goes on. --write puts
the table into results/firmware.md. A self-test that fails stops it.
"""

import argparse
import json
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lab.firmware import dense
from lab.firmware.policies import observe
from lab.firmware.table import INTEGERS, options_of, publish
from lab.firmware.targets import TARGETS, count_split, measure_size, run
from spikedeploy import envs, zoo
from spikedeploy.comparison.statistics import bootstrap, paired_difference
from spikedeploy.envs.rollout import rollout
from spikedeploy.exporters.c.declarations import Declarations
from spikedeploy.policies.native import NativeController
from spikedeploy.policies.onnx import OnnxController
from spikedeploy.runtime.artifact.artifact import load
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.emulator.controllers import SpikingController
from spikedeploy.shipping.export_c import export_c

# of each task the smallest dense policies that earn about what the sparse one does, or the linear
_DENSE = {
    "hexapod": ("mlp-8", "linear"),
    "hexapod-command": ("mlp-16",),
    "kart-gazebo": ("linear",),
    "kart-grid": ("linear",),
    "kart-steer": ("linear",),
}
_FIRST_SEED, _STEPS = 10_000, 200
_OBSERVED_ON = 5_000  # seed of the episode whose observations are counted on


def main() -> None:
    """Measure the policies of each task and print the table."""
    parser = options_of(__doc__, "a task, such as hexapod")
    parser.add_argument("--emlearn", type=Path, required=True, help="a Python that has emlearn")
    parser.add_argument("--episodes", type=int, default=20)
    parser.add_argument("--rows", type=Path, help="a file of rows that were measured")
    options = parser.parse_args()
    rows = []
    for task in _DENSE:
        if options.only in ("", task):
            for policy in ("sparse-gated", *_DENSE[task]):
                rows += _measured(f"{task}/{policy}", options)
    intro = f"Of {options.episodes} episodes, made by `python -m lab firmware-integers "
    intro += "--emlearn VENV/bin/python --write`:\n\n"
    publish(options, rows, INTEGERS, intro)


def _measured(name: str, options: argparse.Namespace) -> list[dict]:
    """Rows of a policy, out of the file where it has them."""
    known = []
    if options.rows and options.rows.is_file():
        known = [json.loads(line) for line in options.rows.read_text().splitlines()]
    found = [r for r in known if (r["policy"], r["episodes"]) == (name, options.episodes)]
    if len(found) == 2:
        return found
    with tempfile.TemporaryDirectory() as folder:
        measure = _sparse if name.endswith("/sparse-gated") else _dense
        found = measure(name, options, Path(folder))
    if options.rows:
        with options.rows.open("a") as file:
            file.writelines(json.dumps(row) + "\n" for row in found)
    return found


def _sparse(name: str, options: argparse.Namespace, folder: Path) -> list[dict]:
    """A sparse policy on loihi1, by each of its interfaces."""
    export_c(name, folder, chip="loihi1")
    run(["make", "-s", "CC=gcc", "test", "test_i16", "lib", "lib_i16"], folder)
    env = envs.make(load(zoo.path(name)).provenance.env)
    seen = _seen(name)
    floats = _returns(env, NativeController(folder / "libpolicy.so"), options.episodes)
    integers = _returns(env, NativeController(folder / "libpolicy_i16.so"), options.episodes)
    env.close()
    kinds = (
        ("doubles", "codec.c", ("FLOATS", "SPIKING"), floats, None),
        ("int16", "codec_i16.c", ("SPIKING",), integers, floats),
    )
    return [
        _row(name, by, folder, ("policy.c", codec), seen, words, returns, beside)
        for by, codec, words, returns, beside in kinds
    ]


def _dense(name: str, options: argparse.Namespace, folder: Path) -> list[dict]:
    """A dense policy in 8-bit weights, and in float by emlearn."""
    file, seen = zoo.path(name), _seen(f"{name.split('/')[0]}/sparse-gated")
    integer, floats = folder / "int8", folder / "float"
    export_c(name, integer)
    run(["make", "-s", "CC=gcc", "test", "lib"], integer)
    floats.mkdir()
    policy = dense.read(file)
    if policy is None:
        raise RuntimeError(f"{name} is more than layers")
    by = f"float, emlearn {dense.write(policy, options.emlearn, seen, floats)}"
    controller = OnnxController(file)
    env = envs.make(controller.metadata["env"])
    wanted = _returns(env, controller, options.episodes)
    found = _returns(env, NativeController(integer / "libpolicy.so"), options.episodes)
    env.close()
    return [
        _row(name, "int8", integer, ("policy.c",), seen, ("DENSE",), found, wanted),
        _row(name, by, floats, ("dense.c",), seen, ("FLOATS",), wanted),
    ]


def _seen(name: str) -> NDArray[np.float64]:
    """Observations (S, obs) of the sparse policy of a task, on which all are counted."""
    artifact = load(zoo.path(name))
    player = SpikingController(artifact, chip("loihi1"), "none", backend="auto")
    return observe(player, artifact.provenance.env, _OBSERVED_ON)[:_STEPS]


def _row(
    name: str,
    by: str,
    folder: Path,
    sources: tuple[str, ...],
    seen: NDArray[np.float64],
    options: tuple[str, ...],
    returns: NDArray[np.float64],
    beside: NDArray[np.float64] | None = None,
) -> dict:
    """All numbers of a policy; beside: returns of the same policy in float on the same seeds."""
    rng = np.random.default_rng(0)
    _write_rows(folder, seen, options)
    row = {"policy": name, "by": by, "episodes": len(returns)}
    row |= {"return": bootstrap(returns, rng).text(",.1f")}
    apart = None if beside is None else paired_difference(returns, beside, rng)
    row["difference"] = "" if apart is None else apart.text("+,.1f")
    least = "least.c" if "FLOATS" in options else "least_i16.c"
    for core in TARGETS:
        row[core] = count_split(core, folder, sources, options) | measure_size(
            core, folder, sources, least
        )
    print(json.dumps(row), file=sys.stderr, flush=True)
    return row


def _write_rows(folder: Path, seen: NDArray[np.float64], options: Sequence[str]) -> None:
    """count_rows.h: the observations as the interface takes them."""
    out = Declarations()
    head = f"#include <stdint.h>\n#define COUNT_ROWS {len(seen)}u\n#define COUNT_SCORES 64\n"
    if "FLOATS" in options:
        head += "#ifndef OBSERVATION\n#define OBSERVATION double\n#endif\n"
        out.constant("count_observation", seen, "double")
        text = out.text.replace("const double", "const OBSERVATION")
    else:
        record = json.loads((folder / "interface.json").read_text())["int16"]
        scaled = seen * 2.0 ** np.array(record["exponent"])
        clipped = np.clip(scaled, record["low"], record["high"])
        out.constant("count_observation", np.rint(clipped).astype(np.int64), "int16_t")
        text = out.text
    (folder / "count_rows.h").write_text(head + text + "\n")


def _returns(env: object, controller: object, episodes: int) -> NDArray[np.float64]:
    """Returns of episodes on the same seeds."""
    seeds = range(_FIRST_SEED, _FIRST_SEED + episodes)
    return np.array([rollout(env, controller, seed).total for seed in seeds])
