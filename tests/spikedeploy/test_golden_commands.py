"""Commands give the numbers that they gave when their golden files were written.

After a change that is meant to change numbers, write the files anew and read their difference:

    WRITE_GOLDEN=1 ./spike test tests/spikedeploy/test_golden_commands.py

Integers, single words and truth values are compared exactly, wherever the test runs; sentences are
not. Floats, and what is made of floats (keys with "bits of"), depend in their last bits on
processor and libraries: where these are the recorded ones they are compared to the bit, elsewhere
floats within 1e-9 of their size, and "bits of", the numbers of trainings among them, not at all.
"""

import csv
import hashlib
import json
import math
import os
import platform
from importlib.metadata import version
from pathlib import Path

import h5py
import numpy as np
import onnx
import onnx.numpy_helper
import pytest

from tests.paths import GOLDEN, ROOT

FOLDER = GOLDEN / "commands"
LIBRARIES = ("numpy", "mujoco", "pymunk", "torch", "onnxruntime")
TOLERANCE = 1e-9  # of a float made on another machine, as `reproduce` has it

# what says when, where and with what, not what came out
PASSING = {"created", "commit", "command", "version", "versions", "sha256", "path", "output",
           "seconds", "evaluated_with", "file", "page", "energy_tables"}  # fmt: skip

NET = ("examples/net.nir", "--chip", "loihi1", "--input", "examples/raster.npy")
ONE = ("--episodes", "1", "--workers", "1", "--json")
COMMANDS = {
    "compare-kart": ("compare", "kart-grid", "kart-grid/snn", "kart-grid/small", *ONE),
    "run-hexapod-loihi1": ("run", "hexapod/popsan", "--chip", "loihi1", "--json"),
    "run-hexapod-gated": ("run", "hexapod/popsan", "--chip", "loihi1:clock=gated", "--json"),
    **{
        f"run-cartpole-{chip}": (
            "run", f"chips/CartPole-v1/{chip}", "--chip", chip, "--seed", "10003", "--json",
        )
        for chip in ("loihi2", "xylo-a2", "odin", "speck2f", "truenorth", "spiker")
    },
    "emulate": ("emulate", *NET, "-o", "out/emulate/spikes.npz", "--json"),
    "drift": ("drift", *NET, "--json"),
    "drift-policy": ("drift", "kart-steer/snn", "--steps", "5", "--json"),
    "check": ("check", "examples/net.nir", "--chip", "loihi1", "--json"),
    "verify": ("verify", *(f"tests/golden/{name}.json" for name in (
        "lava_L_chain_3layers", "brian2loihi_clock_pipelined", "nengoloihi_own_overflow",
        "xylo_D_neg_saturation")), "--json"),
    "reproduce": ("reproduce", "kart-steer/linear", *ONE),
    "export-nir": ("export", "kart-steer/snn", "--to", "nir", "--for", "norse",
                   "-o", "out/export-nir/out.nir", "--json"),
    "export-c": ("export", "kart-steer/snn", "--to", "c", "--chip", "loihi1", "-o", "out/export-c",
                 "--observations", "5", "--json"),
    "sweep": ("sweep", "sweep.toml", "--backend", "serial", "-o", "out/sweep",
              "--json"),
}  # fmt: skip
SWEEP = """
env = "kart-grid"
policy = ["kart-grid/snn", "gap"]
chip = ["loihi1", "float"]
bits = ["own", 4]
fault = ["none", "dead-neurons:1"]
seed = "10000-10001"
episodes = 1
"""

# every algorithm, by its smoke recipe: settings, and the format that its policy is exported to
SPARSE = ("dense_updates=10", "level_updates=10", "polish=0", "teacher_walks=1", "noisy_walks=0",
          "validation.every=10", "budget=400", "levels=[500]")  # fmt: skip
TRAININGS = {
    "smoke": ((), "onnx"),
    "smoke-popsan": ((), "nir"),
    "smoke-distill": (("teacher=hexapod/sac",), "nir"),
    "smoke-kart": (("steps=512",), "nir"),
    "smoke-sparse": (SPARSE, "nir"),
    "smoke-sparse-mlp": (SPARSE, "onnx"),
    "smoke-sparse-delta-mlp": (SPARSE, "nir"),
    "smoke-sparse-tuned": (("start={run}", "iterations=2"), "nir"),  # of smoke-sparse
}


STARTS = {}  # finished runs by their recipes


def machine():
    """Processor and libraries, on which the last bits of floats depend."""
    cpu = Path("/proc/cpuinfo")
    lines = cpu.read_text("utf-8").splitlines() if cpu.exists() else []
    told = dict(tuple(each.strip() for each in line.partition(":")[::2]) for line in lines)
    # processors of one name have other instructions
    names = [told[n] for n in ("model name", "cpu family", "model", "stepping") if n in told]
    return {"processor": " ".join(names) or platform.processor()} | {
        name: version(name) for name in LIBRARIES
    }


def digest(*arrays):
    """The sha256 of the bytes of arrays."""
    return hashlib.sha256(b"".join(np.ascontiguousarray(a).tobytes() for a in arrays)).hexdigest()


def lasting(found):
    """What came out, without times, places, versions and sentences."""
    if isinstance(found, str) and len(found.split()) > 4:
        return "a sentence"
    if isinstance(found, dict):
        return {k: lasting(v) for k, v in found.items() if k not in PASSING}
    return [lasting(each) for each in found] if isinstance(found, list) else found


def is_bits(key):
    return "bits of" in key


def differences(old, new, same_machine, where=""):
    """Each place at which a result is another one than the golden file has."""
    if isinstance(old, dict) and isinstance(new, dict):
        for key in sorted(old.keys() | new.keys()):
            if key not in old or key not in new:
                yield f"{where}/{key}: {'new' if key in new else 'gone'}"
            elif same_machine or not is_bits(key):
                yield from differences(old[key], new[key], same_machine, f"{where}/{key}")
    elif isinstance(old, list) and isinstance(new, list) and len(old) == len(new):
        for k, (a, b) in enumerate(zip(old, new, strict=True)):
            yield from differences(a, b, same_machine, f"{where}/{k}")
    elif isinstance(old, float) and isinstance(new, float) and not same_machine:
        if not math.isclose(old, new, rel_tol=TOLERANCE, abs_tol=TOLERANCE):
            yield f"{where}: was {old!r}, is {new!r}"
    elif json.dumps(old) != json.dumps(new):
        yield f"{where}: was {old!r}, is {new!r}"


def check(name, found):
    """Compare with the golden file, or write it."""
    path = FOLDER / f"{name}.json"
    here = machine()
    found = json.loads(json.dumps({"result": found}))["result"]
    if os.environ.get("WRITE_GOLDEN"):
        text = json.dumps({"machine": here, "result": found}, indent=1, ensure_ascii=False)
        path.write_text(text + "\n", "utf-8")
    golden = json.loads(path.read_text("utf-8"))
    same = golden["machine"] == here
    assert list(differences(golden["result"], found, same)) == []


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with what the commands read, where all trainings go."""
    folder = tmp_path_factory.mktemp("commands")
    for name in ("examples", "spikedeploy", "tests"):
        (folder / name).symlink_to(ROOT / name)
    (folder / "sweep.toml").write_text(SWEEP)
    for name in ("emulate", "export-nir", *TRAININGS):
        (folder / "out" / name).mkdir(parents=True)
    return folder


@pytest.fixture
def ran(folder, monkeypatch, command):
    """Run a command there that succeeds; what it printed."""
    monkeypatch.chdir(folder)

    def run(*words):
        code, out, err = command(*words)
        assert code == 0, err
        return out

    return run


def of_files(folder):
    """Digests of what an export or `emulate` wrote: sources, arrays of .npz, .nir and .onnx."""
    found = {}
    for path in sorted(folder.rglob("*.*")):
        name = path.relative_to(folder).as_posix()
        if path.suffix in (".c", ".h"):  # observations and codec of an export are floats
            floats = "bits of " if path.stem in ("codec", "vectors") else ""
            found[floats + name] = hashlib.sha256(path.read_bytes()).hexdigest()
        elif path.suffix == ".npz":
            with np.load(path) as arrays:
                found |= {each: [list(arrays[each].shape), digest(arrays[each])] for each in arrays}
        elif path.suffix in (".nir", ".onnx"):
            found |= weights(path)
    return found


def weights(path):
    """Name and shape of every array of a policy file; and digests, of which trainings say more."""
    if path.suffix == ".onnx":
        graph = onnx.load(path).graph
        arrays = {each.name: onnx.numpy_helper.to_array(each) for each in graph.initializer}
    else:
        arrays = {}
        with h5py.File(path) as file:
            file["node"].visititems(
                lambda name, node: (
                    arrays.update({name: node[()]})
                    if isinstance(node, h5py.Dataset) and node.dtype.kind == "f" and node.shape
                    else None
                )
            )
    assert arrays
    return {"shapes": {name: list(each.shape) for name, each in sorted(arrays.items())}} | {
        f"bits of {name}": digest(each) for name, each in sorted(arrays.items())
    }


@pytest.mark.parametrize("name", COMMANDS)
def test_a_command_gives_what_it_gave(name, ran, folder):
    said = json.loads(ran(*COMMANDS[name]))
    check(name, {"said": lasting(said), "files": of_files(folder / "out" / name)})


def train(recipe, ran, folder):
    """The finished run of a smoke recipe; trained at first, after the one that it starts from."""
    if recipe not in STARTS:
        settings = TRAININGS[recipe][0]
        start = train("smoke-sparse", ran, folder) if "start={run}" in settings else ""
        words = [word for each in settings for word in ("--set", each.format(run=start))]
        STARTS[recipe] = folder / json.loads(ran("train", recipe, *words, "--json"))["run"]
    return STARTS[recipe]


@pytest.mark.parametrize("recipe", TRAININGS)
def test_a_smoke_training_learns_the_bits_that_it_learned(recipe, ran, folder):
    suffix = TRAININGS[recipe][1]
    run = train(recipe, ran, folder)
    exported = folder / "out" / recipe / f"policy.{suffix}"
    ran("export", run, "--to", suffix, "-o", exported, "--json")
    rows = list(csv.DictReader((run / "metrics.csv").read_text("utf-8").splitlines()))
    timed = [{k: v for k, v in row.items() if not k.endswith("_per_s")} for row in rows]
    metrics = {"rows": len(rows), "columns": list(rows[0]), "bits of metrics": timed}
    check(recipe, {"metrics": metrics, "policy": of_files(exported.parent)})


@pytest.mark.parametrize(
    ("old", "new", "same_machine", "count"),
    [
        ({"a": 1}, {"a": 2}, False, 1),
        ({"a": [1.0]}, {"a": [1.0 + 1e-12]}, True, 1),
        ({"a": [1.0]}, {"a": [1.0 + 1e-12]}, False, 0),
        ({"a": 1.0}, {"a": 1.001}, False, 1),
        ({"a": 1}, {"b": 1}, True, 2),
        ({"bits of w": "x"}, {"bits of w": "y"}, True, 1),
        ({"bits of w": "x"}, {"bits of w": "y"}, False, 0),
        ([1], [1, 2], False, 1),
        (True, 1, False, 1),
    ],
)
def test_another_result_is_found(old, new, same_machine, count):
    assert len(list(differences(old, new, same_machine))) == count
