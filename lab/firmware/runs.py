"""One shipped policy as C: built, compared with the runtime, counted under qemu, timed."""

import ctypes
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from lab.firmware.targets import SOURCES, called, must, on, present
from spikedeploy import envs, zoo
from spikedeploy.envs.rollout import rollout
from spikedeploy.runtime.artifact.artifact import Artifact, load
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.emulator.controllers import SpikingController
from spikedeploy.runtime.emulator.machine import Machine
from spikedeploy.shipping.export_c import export_c

_STRICT = ("-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-ffp-contract=off")
_FIRST_SEED = 10_000


def measured(name: str, folder: Path, episodes: int) -> dict:
    """All numbers of a policy, by name."""
    written = export_c(name, "loihi1", folder)
    row = {"policy": name, "passed": called(["make", "-s", "CC=gcc", "test"], folder)[0]}
    row |= _compared(name, folder, episodes)
    row |= _timed(name, folder)
    row |= {name: written.facts["costs"][name] for name in ("ram", "sops", "events")}
    for target in ("cortex-m4", "rv32imac"):
        found = on(target, folder) if present(target) else {}
        row["passed"] &= found.pop("passed", True)
        row[target] = found
    return row


def _library(folder: Path, name: str, *more: str) -> ctypes.CDLL:
    words = ["gcc", *_STRICT, "-O3", "-march=native", "-fPIC", "-shared", "-I.", "-o", name]
    must([*words, "policy.c", "codec.c", *more, "-lm"], folder)
    return ctypes.CDLL(str(folder / name))


def _compared(name: str, folder: Path, episodes: int) -> dict:
    """Spikes and actions of whole episodes that are compared, and how many differ."""
    loaded = _library(folder, "trace.so", str(SOURCES / "trace.c"), "-DPOLICY_PROBE")
    artifact = load(zoo.path(name))
    player = SpikingController(artifact, chip("loihi1"), "none", backend="auto")
    env = envs.make(artifact.provenance.env)
    found = {"episodes": episodes, "steps": 0, "spikes": 0, "differing": 0, "action_error": 0.0}
    for seed in range(_FIRST_SEED, _FIRST_SEED + episodes):
        seen = rollout(env, player, seed).observation[:-1]
        _replayed(loaded, artifact, player.program, np.asarray(seen, np.float64), found)
    env.close()
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
    env = envs.make(artifact.provenance.env)
    seen = np.asarray(rollout(env, player, _FIRST_SEED).observation[:200], np.float64)
    env.close()
    action = (ctypes.c_double * 64)()
    rows = [row.ctypes.data_as(ctypes.c_void_p) for row in seen]
    loaded.policy_reset()
    own = best(lambda: [loaded.policy_step(row, action) for row in rows])
    empty = best(lambda: [loaded.policy_net_layer(99, 0, action) for _ in rows])
    runtime = best(lambda: [player.act(row) for row in seen])
    spent = max(own - empty, 0.0) / len(rows)
    return {"host_ns": 1e9 * spent, "ratio": runtime / len(rows) / spent}


def best(task: Callable[[], object]) -> float:
    """Seconds of the quickest of seven attempts."""
    spent = []
    for _ in range(7):
        begun = time.perf_counter()
        task()
        spent.append(time.perf_counter() - begun)
    return min(spent)


def in_turns(rows: list[dict], spent: Callable[[dict], float]) -> None:
    """Nanoseconds on this machine of each row's C, and in parts of the first row's.

    Rows take turns, so that what else the machine does meets all of them.
    """
    for row in rows * 5:
        row["host_ns"] = min(row.get("host_ns", np.inf), spent(row))
    for row in rows:
        row["ratio"] = row["host_ns"] / rows[0]["host_ns"]
