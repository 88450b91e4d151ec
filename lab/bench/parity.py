"""Parity of a shipped policy: torch = NumPy float = `ideal`, on observations of its own walks.

    python -m lab parity [FILE.nir …] [--observations 10000]

The torch policy is read back from the file; every spike of every layer is compared in float64, and
how many differ in float32 is reported. Exits with 1 when a check fails.
"""

import argparse
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

import spikedeploy.zoo
from lab.bench.from_nir import from_nir
from spikedeploy import envs
from spikedeploy.envs.rollout import rollout
from spikedeploy.exporters.parity import check
from spikedeploy.runtime.artifact.artifact import load
from spikedeploy.runtime.emulator.controllers import SpikingController
from spikedeploy.runtime.errors import ArtifactError

SHIPPED = sorted(Path(spikedeploy.zoo.__file__).parent.glob("*/*.nir"))
SEED = 5_000  # of the first walk; evaluation begins at 10,000


def main() -> int:
    """Check every file; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("files", nargs="*", type=Path, help="default: all that are shipped")
    parser.add_argument("--observations", type=int, default=10_000)
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    passed = True
    for file in arguments.files or SHIPPED:
        print("/".join(file.parts[-2:]))
        for line in check(from_nir(file), file, walk(file, arguments.observations)):
            passed &= line.passed
            print(f"  {'✓' if line.passed else '✗'} {line.name}: {line.detail}")
    return 0 if passed else 1


def walk(file: Path, count: int) -> NDArray[np.float64]:
    """Return observations (count, obs) that the policy makes in its own environment."""
    artifact = load(file)
    if artifact.provenance is None:
        raise ArtifactError(
            f"{file} was not exported by spikedeploy: it does not name its environment"
        )
    env, controller = envs.make(artifact.provenance.env), SpikingController(artifact)
    walks: list[NDArray[np.float64]] = []
    while sum(map(len, walks)) < count:
        walks.append(rollout(env, controller, SEED + len(walks)).observation)
    return np.concatenate(walks)[:count]
