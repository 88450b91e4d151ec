"""The kits of `export --to program`, run with the tools that they are for.

    python -m lab kits lava --python .venv-peers/lava/bin/python --folder kits

Writes kits for the tool's chips into FOLDER, of shipped and of small made networks, runs each kit's
script with that Python, alone in its folder, and replays what the script recorded by `verify`. Then
the loop is closed, on recorded observations or in the environment. Exits with 1 where anything
differs. A run of every script takes a minute.
"""

import argparse
import json
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import nir
import numpy as np

from spikedeploy.exporters.check import ExportResult
from spikedeploy.exporters.to_program import tool_of
from spikedeploy.runtime.artifact.artifact import Artifact, save
from spikedeploy.runtime.codec.codec import Codec, Normaliser
from spikedeploy.runtime.codec.rate import RateEncoder
from spikedeploy.runtime.convention import Clock, Convention
from spikedeploy.shipping.export_program import export_program

ROOT = Path(__file__).parents[2]
STEPS = 100  # control steps, or timesteps of a raster
_LONGEST = 300  # seconds of a script


@dataclass(frozen=True)
class Case:
    """A kit of a tool.

    name: of its folder.
    chip: that it is for.
    network: shipped policy, file, or what makes one: with a codec a policy of CartPole-v1.
    flags: of the script.
    raster: input of a file without a codec; random where a network without one is made.
    env: in which the loop is closed; empty is recorded observations.
    clock: None is the network's own, or free.
    steps: control steps, or timesteps of a raster.
    """

    name: str
    chip: str
    network: "str | Callable[[], Artifact]"
    flags: tuple[str, ...] = ()
    raster: str | None = None
    env: str = ""
    clock: Clock | None = None
    steps: int = STEPS


def chain(
    weights: Sequence[nir.NIRNode],
    neurons: Callable[[int], nir.NIRNode],
    convention: Convention,
    codec: Codec | None = None,
) -> Artifact:
    """A network of layers, one after another.

    neurons: of a layer of that size.
    """
    sizes = [each.weight.shape[0] for each in weights]
    nodes = {"input": nir.Input(np.array([weights[0].weight.shape[1]]))}
    for k, (each, size) in enumerate(zip(weights, sizes, strict=True), start=1):
        nodes |= {f"w{k}": each, f"n{k}": neurons(size)}
    nodes["output"] = nir.Output(np.array([sizes[-1]]))
    return Artifact(nir.NIRGraph(nodes, list(pairwise(nodes))), codec, convention, None)


def cuba(size: int) -> nir.NIRNode:
    """Neurons with an exponential current, as Xylo's: decays are powers of two."""
    tau_syn, tau_mem = np.full(size, 2e-3), np.full(size, 8e-3)
    gains = {"r": tau_mem / 1e-3, "w_in": tau_syn / 1e-3}
    zero, one = np.zeros(size), np.full(size, 4.0)
    return nir.CubaLIF(tau_syn=tau_syn, tau_mem=tau_mem, v_leak=zero, v_threshold=one, **gains)


def integrators(size: int) -> nir.NIRNode:
    """Neurons that only add up, as Speck's."""
    return nir.IF(np.full(size, 1e3), np.full(size, 1.5))  # r dt is the gain of a weight


def policy(neurons: Callable[[int], nir.NIRNode]) -> Artifact:
    """A policy of CartPole-v1 with random weights: rates of four numbers, 12 neurons, two scores.

    Its neurons spike several times in a timestep.
    """
    rng = np.random.default_rng(4)
    weights = [nir.Linear(rng.normal(size=shape)) for shape in ((12, 4), (2, 12))]
    encoder = RateEncoder(np.full(4, -1.0), np.full(4, 1.0))
    codec = Codec(Normaliser(np.zeros(4), np.full(4, 0.5), 3.0), encoder, 8, "argmax")
    many = Convention(1e-3, reset="subtract", spikes="many", state="kept", source="made here")
    return chain(weights, neurons, many, codec)


def xylo_policy() -> Artifact:
    """A policy for Xylo."""
    return policy(cuba)


def speck_policy() -> Artifact:
    """A policy for Speck."""
    return policy(integrators)


def biased_chain(reset: str) -> Artifact:
    """Integrators with biases, 8, 16 and 4 of them; no codec."""
    rng = np.random.default_rng(1)
    first = nir.Affine(0.6 * rng.normal(size=(16, 8)), 0.05 * rng.normal(size=16))
    second = nir.Linear(0.6 * rng.normal(size=(4, 16)))
    spikes = "many" if reset == "subtract" else "reached"
    convention = Convention(1e-3, reset=reset, spikes=spikes, source="made here")
    return chain([first, second], integrators, convention)


_CHIPS = "chips/CartPole-v1"
_NET, _RASTER = str(ROOT / "examples" / "net.nir"), str(ROOT / "examples" / "raster.npy")
CASES = {
    "lava": (
        Case("sparse-free", "loihi1", "hexapod/sparse-gated"),
        Case("sparse", "loihi1", "hexapod/sparse"),
        Case("recurrent", "loihi1", _NET, raster=_RASTER),
        Case("loihi2", "loihi2", _NET, raster=_RASTER),
        # pipelined, so that spikes are under way where states are reset
        Case("reset", "loihi2", f"{_CHIPS}/loihi2", clock="pipelined", steps=20),
    ),
    "nengo-loihi": (
        Case("sparse", "loihi1-nengo", "hexapod/sparse", env="spikedeploy:hexapod"),
        Case("recurrent", "loihi1-nengo", _NET, raster=_RASTER),
        Case("reset", "loihi1-nengo", "hexapod/popsan", steps=5),
    ),
    "xylosim": (
        Case("cartpole", "xylo-a2", xylo_policy, flags=("--sim",)),
        Case("reset", "xylo-a2", f"{_CHIPS}/xylo-a2", flags=("--sim",), env="CartPole-v1"),
        Case("units", "xylo-a2", "chips/Pendulum-v1/xylo-a2", flags=("--sim",), env="Pendulum-v1"),
    ),
    "sinabs": (
        Case("reset", "speck2f", f"{_CHIPS}/speck2f", env="CartPole-v1"),
        Case("cartpole", "speck2f", speck_policy, env="CartPole-v1"),
        Case("subtract", "speck2f", lambda: biased_chain("subtract")),
        Case("zero", "speck2f", lambda: biased_chain("zero")),
    ),
}


def main() -> int:
    """Run the kits of a tool, print a line for each; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("tool", choices=CASES)
    parser.add_argument("--python", type=Path, required=True, help="of the tool's environment")
    parser.add_argument("--folder", type=Path, required=True, help="for the kits")
    arguments = parser.parse_args()
    folders = {case: arguments.folder / case.name for case in CASES[arguments.tool]}
    equal = [is_equal(case, arguments.python, folder) for case, folder in folders.items()]
    print(f"{sum(equal)} kits equal, {equal.count(False)} different")
    return int(not all(equal))


def is_equal(case: Case, python: Path, folder: Path) -> bool:
    """Run a kit and print its outcomes; return whether nothing differs."""
    try:
        for text in run_case(case, python, folder):
            print(f"✓ {case.name}: {text}")
    except DiffersError as error:
        print(f"✗ {case.name}: {error}")
        return False
    return True


class DiffersError(Exception):
    """A script that failed, or recorded other numbers than are expected."""


def run_case(case: Case, python: Path, folder: Path) -> Iterator[str]:
    """Outcomes of the kit's script, of its trace, and of its loop."""
    kit = write_kit(case, folder)
    yield run_script(python, case, kit.path)
    trace = folder / f"{tool_of(case.chip).name}.json"
    yield _output([sys.executable, "-m", "spikedeploy", "verify", str(trace)], ROOT)
    if "episode.npz" in kit.files:
        loop = ("--loop", case.env) if case.env else ("--loop",)
        yield run_script(python, case, kit.path, *loop)


def write_kit(case: Case, folder: Path) -> ExportResult:
    """The kit of a case; each of its layers spikes."""
    network, env = case.network, None
    raster = None if case.raster is None else Path(case.raster)
    if not isinstance(network, str):
        folder.parent.mkdir(parents=True, exist_ok=True)
        made, path = network(), folder.parent / f"{case.name}.nir"
        save(made, path)
        network, env = str(path), "CartPole-v1" if made.codec else None
        if not made.codec:
            width = int(made.graph.inputs["input"].input_type["input"][0])
            raster = folder.parent / f"{case.name}.npy"
            drawn = np.random.default_rng(2).random((STEPS, width)) < 0.4
            np.save(raster, drawn.astype(np.uint8))
    kit = export_program(
        network,
        folder,
        chip=case.chip,
        observations=case.steps,
        raster=raster,
        env=env,
        clock=case.clock,
    )
    recorded = json.loads((folder / "expected.json").read_text("utf-8"))["recorded"]
    program = json.loads((kit.path / "program.json").read_text("utf-8"))
    can = {layer["name"]: layer["spiking"] for layer in program["layers"]}
    for name, each in recorded.items():
        if can[name] and not np.any(each["spikes"]):
            raise DiffersError(f"layer {name} never spikes, so that the kit shows little")
    return kit


def run_script(python: Path, case: Case, folder: Path, *more: str) -> str:
    """Output of the kit's script; it sees nothing but its folder."""
    return _output([str(python), tool_of(case.chip).script, *case.flags, *more], folder)


def _output(command: list[str], folder: Path) -> str:
    """The last lines of a command; DiffersError where it fails."""
    done = subprocess.run(
        command, cwd=folder, capture_output=True, text=True, check=False, timeout=_LONGEST
    )
    if done.returncode:
        lines = (done.stdout + done.stderr).strip().splitlines() or ["nothing was said"]
        raise DiffersError(f"{' '.join(command[1:])}: {lines[-1]}")
    return " ".join(done.stdout.split("\n")).strip()
