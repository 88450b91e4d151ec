"""Parity: a written file is read back and compared with the policy on the same observations."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from spikedeploy.exporters.check import ParityCheck
from spikedeploy.exporters.nir_parity import nir_checks
from spikedeploy.exporters.onnx_parity import onnx_checks
from spikedeploy.runtime.errors import ConfigError, ObservationError
from spikedeploy.trainers.policies import Policy

__all__ = ["CHECKS", "ParityCheck", "check"]

Checks = Callable[[Policy, Path, NDArray[np.float64]], list[ParityCheck]]

CHECKS: dict[str, Checks] = {".nir": nir_checks, ".onnx": onnx_checks}


def check(policy: Policy, path: str | Path, observations: ArrayLike) -> list[ParityCheck]:
    """Return the checks of the file against the policy on observations (n, obs)."""
    path = Path(path)
    if path.suffix not in CHECKS:
        raise ConfigError(f"{path}: parity is defined for files that end in {' or '.join(CHECKS)}")
    recorded = np.asarray(observations, dtype=np.float64)
    if recorded.ndim != 2 or recorded.shape[1] != policy.observations or not len(recorded):
        raise ObservationError(
            f"parity needs observations of shape (n, {policy.observations}), at least one; "
            f"found {recorded.shape}"
        )
    return CHECKS[path.suffix](policy, path, recorded)
