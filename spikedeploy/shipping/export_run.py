"""Export with proof: the written file is read back and compared with the policy it came from."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from spikedeploy import envs
from spikedeploy.envs.rollout import rollout
from spikedeploy.exporters import exporter
from spikedeploy.exporters.check import ParityCheck
from spikedeploy.exporters.parity import check
from spikedeploy.policies import run_record
from spikedeploy.policies.run import TorchController
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.seeds import VALIDATION
from spikedeploy.trainers.run_folder import RunFolder, load_policy

if TYPE_CHECKING:
    from spikedeploy.runtime.convention import State
    from spikedeploy.trainers.policies import Policy

OBSERVATIONS = 1000
SPIKING = ("popsan", "spiking-mlp")  # kinds of policies, which NIR describes


@dataclass(frozen=True)
class Exported:
    """A written file, and what comparing it with its policy has shown.

    path    of the file
    kind    "ann", "snn" or "control", as comparisons will call it
    checks  in the order in which they were made
    """

    path: Path
    kind: str
    checks: list[ParityCheck]

    @property
    def passed(self) -> bool:
        """Whether every check did."""
        return all(each.passed for each in self.checks)


def export(
    run: str,
    to: str,
    path: Path | None = None,
    observations: int = OBSERVATIONS,
    control: bool = False,
    state: "State" = "reset",
) -> Exported:
    """Write a run's policy as a file.

    run           run folder, its name under runs/, or "last"
    to            key of exporters.EXPORTERS
    path          of the file; by default policy.<to> in the run folder
    observations  recorded from the policy's own episodes, on which the file is compared with it
    control       whether comparisons shall show a float network as a control
    state         "kept" carries the membranes of a spiking policy on from inference to inference
    """
    if state != "reset" and to != "nir":
        raise ConfigError(f"only a .nir file has membranes to keep: leave --state out for {to}")
    folder = RunFolder.find(run).path
    policy = load_policy(folder)
    path = path or folder / f"policy.{to}"
    path.parent.mkdir(parents=True, exist_ok=True)
    kind = kind_of(policy, control)
    options: dict[str, dict[str, str]] = {"nir": {"state": state}, "onnx": {"kind": kind}}
    exporter(to)(policy, run_record.origin(folder), path, **options.get(to, {}))
    return Exported(path, kind, check(policy, path, recorded(folder, observations)))


def kind_of(policy: "Policy", control: bool = False) -> str:
    """What comparisons call the policy: a float network that sees less than all is a control."""
    if policy.kind in SPIKING:
        return "snn"
    spec = policy.spec()
    sees_all = spec["features"]["name"] == "all"
    return "ann" if sees_all and spec["hidden"] and not control else "control"


def recorded(run: Path, count: int) -> NDArray[np.float64]:
    """Observations (count, obs) that the run's policy makes in its environment."""
    world = run_record.settings(run)["env"]
    env = envs.make(world["name"], **world["options"])
    controller = TorchController(str(run))
    episodes: list[NDArray[np.float64]] = []
    while sum(map(len, episodes)) < count:
        seed = VALIDATION[len(episodes)]
        episodes.append(rollout(env, controller, seed).observation)
    env.close()
    return np.concatenate(episodes)[:count]
