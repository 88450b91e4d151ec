"""Commands give the numbers that they gave when their golden files were written.

After a change that is meant to change numbers, write the files anew and read their difference:

    WRITE_GOLDEN=1 ./spike test tests/spikedeploy/test_golden_commands.py

Integers, single words and truth values are compared exactly, wherever the test runs; sentences are
not. The last bits of floats depend on what libraries choose for a processor, its caches and cores:
floats are compared within BOUNDS, and what is made of their bits (keys with "bits of") only where
somebody asks for it, who sits at the machine that wrote the files or at one that is like it:

    ./spike test --record tests/spikedeploy/test_golden_commands.py
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
from tests.trainers.kills import differences as differing_files

FOLDER = GOLDEN / "commands"
LIBRARIES = ("numpy", "mujoco", "pymunk", "torch", "onnxruntime")
TOLERANCE = 1e-9  # of a float, relative, as `reproduce` has it
# Relative bounds of what goes through many steps, in which a last bit may grow: an episode of a
# hexapod, and a training after its first row. Behind them is what was measured on an AMD EPYC
# 25 1 1, the largest difference of any number under ATEN_CPU_CAPABILITY=default, under
# MKL_CBWR=COMPATIBLE, and under both with OPENBLAS_CORETYPE=Sandybridge,
# NPY_DISABLE_CPU_FEATURES=X86_V3 and ONEDNN_MAX_CPU_ISA=SSE41; in parentheses with noise of 1e-6 on
# all weights after each of Adam's steps. An Intel Xeon with AVX-512 differs by less than 1e-5 in
# the first four trainings. Pruning is chaotic: its bounds are no more than a range.
BOUNDS = {
    "run-hexapod-loihi1": 0.02,  # 0.0022
    "run-hexapod-gated": 0.02,  # 0.0022
    "smoke": 0.01,  # 2e-7 (2e-4)
    "smoke-kart": 0.01,  # 2e-5 (9e-6)
    "smoke-popsan": 0.1,  # 1e-5 (3e-5)
    "smoke-distill": 0.1,  # 2e-7 (0.02)
    "smoke-sparse": 0.5,  # 3e-6 (5e-5)
    "smoke-sparse-mlp": 0.5,  # 2e-4 (0.2)
    "smoke-sparse-tuned": 0.5,  # 8e-7 (3e-5)
}
FIRST = 1e-3  # of a training's first row: 1e-5 (9e-6)

# what a training counts, which is exact; its other numbers are floats
COUNTS = {"updates", "env_steps", "iterations", "iteration", "phase", "walks", "episodes"}
# near 0, or differences of numbers that are nearly the same: finite, and no more
UNBOUNDED = {"heading_error", "gain", "eval_gain", "kl", "clipped", "explained", "eval_share"}

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
            "run", f"chips/CartPole-v1/{chip}", "--chip", chip, "--seed", "10003",
            "--set", "max_episode_steps=50", "--json",
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
    "sweep": ("sweep", "sweep.toml", "--workers", "1", "-o", "out/sweep", "--json"),
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
    "smoke-sparse-tuned": (("start={run}", "iterations=2"), "nir"),  # of smoke-sparse
}

RUNS = {}  # finished ones by their recipes


def machine():
    """Processor and libraries, for those who find other bits."""
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
    """What came out, without times, places, versions, sentences and what has no bounds."""
    if isinstance(found, str) and len(found.split()) > 4:
        return "a sentence"
    if isinstance(found, dict):
        return {
            k: math.isfinite(v) if k in UNBOUNDED and isinstance(v, float) else lasting(v)
            for k, v in found.items()
            if k not in PASSING
        }
    return [lasting(each) for each in found] if isinstance(found, list) else found


def differences(old, new, bound=TOLERANCE, where=""):
    """Each place at which a result is another one than the golden file has."""
    if isinstance(old, dict) and isinstance(new, dict):
        for key in sorted(old.keys() | new.keys()):
            if key not in old or key not in new:
                yield f"{where}/{key}: {'new' if key in new else 'gone'}"
            elif "bits of" not in key:
                near = min(bound, FIRST) if key == "first" else bound
                yield from differences(old[key], new[key], near, f"{where}/{key}")
    elif isinstance(old, list) and isinstance(new, list) and len(old) == len(new):
        for k, (a, b) in enumerate(zip(old, new, strict=True)):
            yield from differences(a, b, bound, f"{where}/{k}")
    elif isinstance(old, float) and isinstance(new, float):
        if not math.isclose(old, new, rel_tol=bound, abs_tol=TOLERANCE):
            yield f"{where}: was {old!r}, is {new!r}"
    elif json.dumps(old) != json.dumps(new):
        yield f"{where}: was {old!r}, is {new!r}"


def golden(name):
    """The golden file of a result."""
    return FOLDER / f"{name}.json"


def check(name, found):
    """Compare with the golden file, or write it."""
    if os.environ.get("WRITE_GOLDEN"):
        text = json.dumps({"machine": machine(), "result": found}, indent=1, ensure_ascii=False)
        golden(name).write_text(text + "\n", "utf-8")
    old = json.loads(golden(name).read_text("utf-8"))["result"]
    new = json.loads(json.dumps(found))
    assert list(differences(old, new, BOUNDS.get(name, TOLERANCE))) == []


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


def result(name, ran, folder):
    """What a command gave."""
    said = json.loads(ran(*COMMANDS[name]))
    return {"said": lasting(said), "files": of_files(folder / "out" / name)}


@pytest.mark.parametrize("name", COMMANDS)
def test_a_command_gives_what_it_gave(name, ran, folder):
    check(name, result(name, ran, folder))


def train(recipe, ran, folder):
    """A new run of a smoke recipe, which may start from a finished one."""
    settings = TRAININGS[recipe][0]
    start = trained("smoke-sparse", ran, folder) if "start={run}" in settings else ""
    words = [word for each in settings for word in ("--set", each.format(run=start))]
    return folder / json.loads(ran("train", recipe, *words, "--json"))["run"]


def trained(recipe, ran, folder):
    """The finished run of a smoke recipe; trained at first."""
    if recipe not in RUNS:
        RUNS[recipe] = train(recipe, ran, folder)
    return RUNS[recipe]


def learned(recipe, ran, folder):
    """Metrics and policy of a smoke training."""
    suffix = TRAININGS[recipe][1]
    run = trained(recipe, ran, folder)
    exported = folder / "out" / recipe / f"policy.{suffix}"
    ran("export", run, "--to", suffix, "-o", exported, "--json")
    rows = list(csv.DictReader((run / "metrics.csv").read_text("utf-8").splitlines()))
    timed = [{k: v for k, v in row.items() if not k.endswith("_per_s")} for row in rows]
    found = lasting([numbers(row) for row in timed])
    begun = 0 if recipe == "smoke-sparse-tuned" else 1  # it goes on from where another one ended
    metrics = {"columns": list(rows[0]), "first": found[:begun], "later": found[begun:]}
    policy = of_files(exported.parent)
    if recipe.startswith("smoke-sparse"):  # pruning may end with another neuron
        policy["shapes"] = {array: len(shape) for array, shape in policy["shapes"].items()}
    return {"metrics": metrics | {"bits of metrics": timed}, "policy": policy}


def numbers(row):
    """The numbers of a row of metrics.csv; nothing where it has none."""
    return {k: int(v) if k in COUNTS else float(v) for k, v in row.items() if v not in ("", "nan")}


@pytest.mark.parametrize("recipe", TRAININGS)
def test_a_smoke_training_learns_what_it_learned(recipe, ran, folder):
    check(recipe, learned(recipe, ran, folder))


@pytest.mark.parametrize("recipe", ["smoke", "smoke-kart", "smoke-sparse"])
def test_a_smoke_training_learns_the_same_bits_again(recipe, ran, folder):
    first, second = trained(recipe, ran, folder), train(recipe, ran, folder)
    assert first != second
    assert differing_files(first, second) == []


@pytest.mark.record
@pytest.mark.parametrize("name", [*COMMANDS, *TRAININGS])
def test_every_bit_is_the_one_that_was_written(name, ran, folder):
    found = (result if name in COMMANDS else learned)(name, ran, folder)
    written = json.loads(golden(name).read_text("utf-8"))
    assert json.loads(json.dumps(found)) == written["result"], f"{written['machine']}, {machine()}"


@pytest.mark.parametrize(
    ("old", "new", "count"),
    [
        ({"a": 1}, {"a": 2}, 1),
        ({"a": [1.0]}, {"a": [1.0 + 1e-12]}, 0),
        ({"a": 1.0}, {"a": 1.001}, 1),
        ({"a": 1}, {"b": 1}, 2),
        ({"bits of w": "x"}, {"bits of w": "y"}, 0),
        ({"bits of w": "x"}, {}, 1),
        ([1], [1, 2], 1),
        (True, 1, 1),
        (1, 1.0, 1),
        (1.0, math.nan, 1),
    ],
)
def test_another_result_is_found(old, new, count):
    assert len(list(differences(old, new))) == count
