"""A `.nir` file as one step in ONNX, compared with its float twin on an episode."""

from pathlib import Path

from spikedeploy import zoo
from spikedeploy.exporters.spiking_onnx import KIND, checks, spiking_to_onnx
from spikedeploy.outputs import check_output, marked
from spikedeploy.runtime.artifact.artifact import load
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.shipping.export_c import episode_of, world_of
from spikedeploy.shipping.export_run import ExportedPolicy


def is_nir_file(reference: str) -> bool:
    """Whether a reference is a `.nir` file or a shipped policy in one."""
    file = zoo.resolve(reference)
    return file is not None and file.is_file() and file.suffix == ".nir"


def export_onnx(
    policy: str, path: Path | None, observations: int = 1000, force: bool = False
) -> ExportedPolicy:
    """Write a policy as one step in ONNX.

    policy        .nir file or shipped policy
    path          to write to
    observations  most of an episode, on which file and float twin are compared
    force         whether a file that no export wrote is replaced
    """
    if path is None:
        raise ConfigError("--to onnx of a file: name the one to write, as in -o step.onnx")
    file = zoo.resolve(policy)
    if file is None:
        raise ConfigError(f"there is no file {policy}")
    check_output("-o", path, (file,), force, lambda found: marked(found, KIND))
    artifact = load(file)
    path.parent.mkdir(parents=True, exist_ok=True)
    spiking_to_onnx(artifact, path)
    seen, _ = episode_of(artifact, None, observations, world_of(policy, artifact))
    return ExportedPolicy(path, checks(artifact, path, seen), kind="snn")
