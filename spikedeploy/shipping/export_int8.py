"""A small float policy as C99 with 8-bit weights: the folder, and how far its actions move."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikedeploy import envs, zoo
from spikedeploy.envs.rollout import rollout
from spikedeploy.exporters.c.int8 import Int8Mlp, dense_names, mlp_in_c, quantise, read_onnx
from spikedeploy.exporters.c.plan import check_prefix
from spikedeploy.make_env import make_env
from spikedeploy.outputs import check_output_folder
from spikedeploy.policies.onnx import OnnxController
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.seeds import VALIDATION
from spikedeploy.shipping.export_c import write, written_before

_STEPS = 200  # of the self-test


@dataclass(frozen=True)
class WrittenInt8:
    """A folder of C.

    folder: with the files.
    names: of the files.
    weights: that are not 0.
    largest: difference of an action from the float network's; of choices, the part that differs.
    chooses: whether actions are choices.
    source: of the observations behind it.
    """

    folder: Path
    names: tuple[str, ...]
    weights: int
    largest: float
    chooses: bool
    source: str

    def record(self) -> dict[str, Any]:
        """All of it as data."""
        return {
            "path": str(self.folder),
            "files": list(self.names),
            "weights": self.weights,
            "largest_difference": self.largest,
            "recorded": self.source,
        }

    def lines(self) -> list[str]:
        """All of it for a terminal."""
        apart = (
            f"{self.largest:.2%} of choices differ from the float network's"
            if self.chooses
            else f"actions differ from the float network's by at most {self.largest:.4f}"
        )
        return [
            f"weights of 8 bits      {self.weights:,} that are not 0",
            f"{apart}, on {self.source}",
            f"wrote {self.folder}: {', '.join(self.names)}",
            f"compare with the specification in Python: make -C {self.folder} test",
        ]


def onnx_file(policy: str) -> Path | None:
    """The ONNX file of a policy; None where it is of another kind."""
    from spikedeploy.shipping.exported_run import runnable

    file = zoo.resolve(policy)
    if file is None or file.is_dir():
        file = Path(runnable(policy))
    return file if file.suffix == ".onnx" and file.is_file() else None


def export_int8(
    file: Path,
    policy: str,
    chip_name: str | None,
    folder: Path | None,
    observations: int = 1000,
    prefix: str = "policy",
    force: bool = False,
) -> WrittenInt8:
    """Write a float policy as C with 8-bit weights.

    file: its ONNX file; policy: as the user named it.
    chip_name: refused, as no chip is emulated.
    observations: of an episode, on which the actions are compared.
    """
    if chip_name is not None:
        raise ConfigError(
            f"--to c: {policy} is a float network, whose C is of no chip; leave --chip out."
        )
    if folder is None:
        raise ConfigError("--to c writes a folder: name it, as in -o firmware")
    check_prefix(prefix)
    controller = OnnxController(file)
    network = quantise(read_onnx(file))
    check_output_folder("-o", folder, dense_names(prefix), (file, policy), force, written_before)
    seen, source = _episode(controller, network, observations)
    origin = f"{zoo.called(str(file))}, sha256 {zoo.sha256(file)[:16]}, in 8-bit weights"
    files = mlp_in_c(network, seen[:_STEPS], origin, prefix)
    write(files.text, folder, prefix)
    found = network.floats(network.act(network.observations.quantise(seen)))
    apart = np.abs(found - np.asarray(controller.replay(seen)).reshape(found.shape))
    largest = float((apart > 0).mean() if network.chooses else apart.max())
    return WrittenInt8(folder, tuple(files.text), network.weights, largest, network.chooses, source)


def _episode(
    controller: OnnxController, network: Int8Mlp, count: int
) -> tuple[NDArray[np.float64], str]:
    """Observations (S, obs) of an episode in its environment, else of a random walk, and which."""
    where = controller.metadata.get("env", "")
    if where in {entry.id for entry in envs.ENVS.values()}:
        env = make_env(where, {})
        played = rollout(env, controller, VALIDATION[0])
        env.close()
        seen = np.asarray(played.observation[:-1], np.float64)[:count]
        return seen, f"{len(seen)} control steps in {where}, seed {VALIDATION[0]}"
    scales = network.observations
    middle, half = (scales.low + scales.high) / 2, (scales.high - scales.low) / 2
    steps = np.random.default_rng(0).normal(0, 0.05, (count, len(half)))
    walk = middle + half * np.clip(np.cumsum(steps, axis=0), -0.75, 0.75)
    return walk / 2.0**scales.exponent, f"{count} steps of a random walk"
