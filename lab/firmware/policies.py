r"""Shipped policies as C: equal spikes in whole episodes, sizes, instructions on two cores.

    python -m lab firmware [--episodes 20] [--only hexapod/sparse] [--write]

Each policy is exported as `spikedeploy export --to c --chip loihi1` does it. Its C plays back the
observations of episodes, and every spike and action is compared with the runtime's. For a
Cortex-M4 (no floating-point unit used) and a RV32IMAC core it is built with Debian's compilers and
picolibc; the self-test runs under qemu, which also counts the instructions of a control step. Needs
gcc; what else is missing leaves a dash:

    apt-get install --no-install-recommends gcc-arm-none-eabi picolibc-arm-none-eabi \
        gcc-riscv64-unknown-elf picolibc-riscv64-unknown-elf qemu-system-arm qemu-system-misc

--write puts the table into results/firmware.md. Exits with 1 where something differs.
"""

import argparse
import ctypes
import json
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lab.firmware.targets import (
    SOURCES,
    attempt,
    best,
    count_instructions,
    is_installed,
    run,
    run_words,
)
from spikedeploy import envs, zoo
from spikedeploy.envs.rollout import rollout
from spikedeploy.reports.table import ABSENT, markdown_text
from spikedeploy.runtime.artifact.artifact import Artifact, load
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.emulator.controllers import SpikingController
from spikedeploy.runtime.emulator.machine import Machine
from spikedeploy.runtime.files import write_text
from spikedeploy.shipping.export_c import export_c

_STRICT = ("-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-ffp-contract=off")
_FIRST_SEED = 10_000
PAGE = Path(__file__).parents[2] / "results" / "firmware.md"


_COLUMNS = (
    "policy", "ROM [kB]", "RAM [kB]", "M4 instructions", "at most", "RV32 instructions", "at most",
    "host [µs]", "runtime / C", "spikes compared", "steps that differ",
)  # fmt: skip


def main() -> None:
    """Measure the policies and print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--only", default="", help="a policy, such as hexapod/sparse")
    parser.add_argument("--write", action="store_true", help=f"the table into {PAGE.name}")
    parser.add_argument("--episodes", type=int, default=20)
    options = parser.parse_args()
    names = [name for name in zoo.names() if zoo.path(name).suffix == ".nir"]
    rows = []
    for name in names:
        if options.only in ("", name):
            with tempfile.TemporaryDirectory() as folder:
                rows.append(measure(name, Path(folder), options.episodes))
            print(json.dumps(rows[-1]), file=sys.stderr, flush=True)
    print(made := table(rows))
    if options.write:
        intro = f"Of {options.episodes} episodes each, made by `python -m lab firmware --write`:"
        head, _, rest = PAGE.read_text("utf-8").partition("<!-- firmware -->\n")
        end = rest[rest.index("<!-- end of firmware -->") :]
        write_text(PAGE, f"{head}<!-- firmware -->\n{intro}\n\n{made}\n{end}")
    sys.exit(any(row["differing"] or not row["passed"] for row in rows))


def table(rows: Sequence[dict[str, Any]]) -> str:
    """Return the rows as Markdown; a dash where a tool was missing."""

    def kilobytes(count: int | None) -> str:
        return ABSENT if count is None else f"{count / 1000:.1f}"

    def number(count: int | None) -> str:
        return ABSENT if count is None else f"{count:,}"

    lines = []
    for row in rows:
        arm, risc = row["cortex-m4"], row["rv32imac"]
        cores = [
            number(c.get(n)) for c in (arm, risc) for n in ("instructions", "instructions_max")
        ]
        sizes = [kilobytes(arm.get(name)) for name in ("rom", "static")]
        times = f"{row['host_ns'] / 1000:.2f}", f"{row['ratio']:.3g}"
        compared = number(row["spikes"]), f"{number(row['differing'])} of {number(row['steps'])}"
        lines.append([row["policy"], *sizes, *cores, *times, *compared])
    return markdown_text([_COLUMNS, *lines])


def measure(name: str, folder: Path, episodes: int) -> dict:
    """All numbers of a policy, by name."""
    costs = export_c(name, folder, chip="loihi1").facts["costs"]
    row = {"policy": name, "passed": attempt(["make", "-s", "CC=gcc", "test"], folder)[0]}
    row |= _compared(name, folder, episodes) | _timed(name, folder)
    row |= {count: costs[count] for count in ("ram", "sops", "events")}
    for target in ("cortex-m4", "rv32imac"):
        row[target] = {}
        if is_installed(target):
            probed = ["-DPOLICY_PROBE", "policy.c", "codec.c", "selftest.c"]
            passed, output = attempt(run_words(target, folder, probed), folder)
            row["passed"] &= passed and "0 differ" in output
            row[target] = count_instructions(target, folder)
    return row


def observe(player: SpikingController, env_id: str, seed: int) -> NDArray[np.float64]:
    """Observations (S, obs) of an episode, the last one left out."""
    env = envs.make(env_id)
    seen = rollout(env, player, seed).observation[:-1]
    env.close()
    return np.asarray(seen, np.float64)


def _library(folder: Path, name: str, *more: str) -> ctypes.CDLL:
    words = ["gcc", *_STRICT, "-O3", "-march=native", "-fPIC", "-shared", "-I.", "-o", name]
    run([*words, "policy.c", "codec.c", *more, "-lm"], folder)
    return ctypes.CDLL(str(folder / name))


def _compared(name: str, folder: Path, episodes: int) -> dict:
    """Spikes and actions of whole episodes that are compared, and how many differ."""
    loaded = _library(folder, "trace.so", str(SOURCES / "trace.c"), "-DPOLICY_PROBE")
    artifact = load(zoo.path(name))
    player = SpikingController(artifact, chip("loihi1"), "none", backend="auto")
    found = {"episodes": episodes, "steps": 0, "spikes": 0, "differing": 0, "action_error": 0.0}
    for seed in range(_FIRST_SEED, _FIRST_SEED + episodes):
        seen = observe(player, artifact.provenance.env, seed)
        _replayed(loaded, artifact, player.program, seen, found)
    return found


def _replayed(
    loaded: ctypes.CDLL, artifact: Artifact, program: Program, seen: np.ndarray, found: dict
) -> None:
    """One episode once more, in C and on the machine."""
    codec = artifact.codec
    machine = Machine(program, 1, "none", trace=True, backend="auto")
    loaded.policy_reset()
    kind = ctypes.c_int32 if codec.chooses else ctypes.c_double
    action = (kind * 64)()
    count = ctypes.c_uint32.in_dll(loaded, "trace_count")
    spikes = (ctypes.c_uint16 * (2 << 16)).in_dll(loaded, "trace_spikes")
    for row, raster in zip(seen, codec.encode_episode(seen), strict=True):
        loaded.policy_step(row.ctypes.data_as(ctypes.c_void_p), action)
        wanted = np.atleast_1d(codec.decode(machine.infer(raster[None]))[0])
        pairs = _pairs(program, machine.recordings)
        here = np.frombuffer(spikes, np.uint16)[: 2 * count.value].reshape(-1, 2)
        same = here.shape == pairs.shape and bool((here == pairs).all())
        error = float(np.abs(np.array(action[: len(wanted)]) - wanted).max())
        found["steps"] += 1
        found["spikes"] += len(pairs)
        found["differing"] += not same or error > 1e-12
        found["action_error"] = max(found["action_error"], error)


def _pairs(program: Program, recordings: dict) -> np.ndarray:
    """(spikes, 2) layer and neuron, as trace.c keeps them."""
    every = []
    for k, layer in enumerate(program.layers):
        _, t, n = np.nonzero(recordings[layer.name].spikes)
        every.append(np.stack([t, np.full_like(t, k), n], axis=1))
    rows = np.concatenate(every)
    return rows[np.lexsort((rows[:, 2], rows[:, 1], rows[:, 0]))][:, 1:].astype(np.uint16)


def _timed(name: str, folder: Path) -> dict:
    """Nanoseconds from observation to action in C, and how many times that the runtime takes."""
    loaded, artifact = _library(folder, "timed.so"), load(zoo.path(name))
    player = SpikingController(artifact, chip("loihi1"), "none", backend="auto")
    seen = observe(player, artifact.provenance.env, _FIRST_SEED)[:200]
    action = (ctypes.c_double * 64)()
    rows = [row.ctypes.data_as(ctypes.c_void_p) for row in seen]
    loaded.policy_reset()
    own = best(lambda: [loaded.policy_step(row, action) for row in rows])
    empty = best(lambda: [loaded.policy_net_layer(99, 0, action) for _ in rows])
    runtime = best(lambda: [player.act(row) for row in seen])
    spent = max(own - empty, 0.0) / len(rows)
    return {"host_ns": 1e9 * spent, "ratio": runtime / len(rows) / spent}
