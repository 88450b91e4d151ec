"""Export of a run's policy: the file is read back and compared with the policy."""

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from spikedeploy import envs
from spikedeploy.envs.rollout import rollout
from spikedeploy.exporters.check import ExportResult
from spikedeploy.exporters.parity import check
from spikedeploy.exporters.to_nir import to_nir
from spikedeploy.exporters.to_onnx import to_onnx
from spikedeploy.outputs import check_output
from spikedeploy.policies import run_record
from spikedeploy.policies.run_record import SPIKING, TorchController, policy_of
from spikedeploy.runtime.artifact.artifact import load
from spikedeploy.runtime.errors import ConfigError, SpikedeployError
from spikedeploy.runtime.files import suffix
from spikedeploy.runtime.metadata import Provenance
from spikedeploy.seeds import VALIDATION
from spikedeploy.trainers.onnx_session import session
from spikedeploy.trainers.run_folder import RunFolder

if TYPE_CHECKING:
    from spikedeploy.runtime.convention import State
    from spikedeploy.trainers.policies import Policy


def export_run(
    run: str,
    to: str,
    path: Path | None = None,
    observations: int = 1000,
    control: bool = False,
    state: "State | None" = None,
    checkpoint: str | None = None,
    force: bool = False,
) -> ExportResult:
    """Write a run's policy as a file.

    run: run folder, its name under runs/, or "last".
    to: "nir" or "onnx".
    path: path of the file; by default policy.<to> in the run folder, or policy-<checkpoint>.<to>.
    observations: number of recorded observations on which file and policy are compared.
    control: whether comparisons show a float network as a control.
    state: state of a spiking policy between inferences; None as trained.
    checkpoint: of the run, such as "ops-480"; by default its best, else its last.
    force: whether a file that no export of this training wrote is replaced.

    The facts have the kind for comparisons: "ann", "snn" or "control".
    """
    folder = RunFolder.find(run).path
    if state == "kept" and to != "nir":
        raise ConfigError(f"only a .nir file has membranes to keep: leave --state out for {to}")
    policy = policy_of(folder, RunFolder(folder).deployed(checkpoint))
    origin, kind = run_record.origin(folder, checkpoint), kind_of(policy, control)
    # where no path is given, it is our own file in the run folder
    force |= path is None
    path = path or folder / f"policy{f'-{checkpoint}' if checkpoint else ''}.{to}"
    check_output("-o", path, (folder,), force, partial(_same_training, origin))
    path.parent.mkdir(parents=True, exist_ok=True)
    if to == "nir":
        to_nir(policy, origin, path, state=state)
    else:
        to_onnx(policy, origin, path, kind)
    checks = check(policy, path, record_observations(folder, observations, checkpoint))
    late = run_record.describe_progress(folder)
    remarks = (f"its training is unfinished: stopped at {late}",) if late else ()
    return ExportResult(path, (), tuple(checks), {"kind": kind}, (f"wrote {path}",), remarks)


def _same_training(origin: Provenance, path: Path) -> bool:
    """True where a file is an export of the same training."""
    try:
        if suffix(path) == ".onnx":
            said = session(path).get_modelmeta().custom_metadata_map
            found = Provenance(said["env"], said["recipe"], int(said["seed"]))
        else:
            stored = load(path)
            found = Provenance("") if stored.tuned else stored.provenance or Provenance("")
    except (SpikedeployError, KeyError, ValueError):
        return False
    return (found.env, found.recipe, found.seed) == (origin.env, origin.recipe, origin.seed)


def kind_of(policy: "Policy", control: bool = False) -> str:
    """The kind for comparisons; a float network that is linear or pruned is a control."""
    if policy.kind in SPIKING:
        return "snn"
    if policy.kind.startswith("pruned"):
        return "control"
    return "ann" if policy.spec()["hidden"] and not control else "control"


def record_observations(
    run: Path, count: int, checkpoint: str | None = None
) -> NDArray[np.float64]:
    """Observations (count, obs) from episodes of the policy of a checkpoint."""
    world = run_record.settings(run)["env"]
    env = envs.make(world["name"], **world["options"])
    controller = TorchController(str(run), checkpoint=checkpoint)
    episodes: list[NDArray[np.float64]] = []
    while sum(map(len, episodes)) < count:
        seed = VALIDATION[len(episodes)]
        episodes.append(rollout(env, controller, seed).observation)
    env.close()
    return np.concatenate(episodes)[:count]
