"""Parity of an ONNX file: ONNX Runtime against the policy in torch."""

from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from spikedeploy.exporters.check import LargestDifference, ParityCheck, batches
from spikedeploy.exporters.onnx_graph import OBSERVATION, OUTPUTS
from spikedeploy.trainers.onnx_session import session
from spikedeploy.trainers.policies import Policy

# of an action in [-1, 1], or of the largest logit: float32 sums in different order
TOLERANCE = 1e-5
ALONE = 100  # observations that are also passed one by one, as in a control loop

Single = NDArray[np.float32]


def onnx_checks(policy: Policy, path: Path, observations: NDArray[np.float64]) -> list[ParityCheck]:
    """Return the checks of the file on observations (n, obs)."""
    single = deepcopy(policy).float()
    network = session(path)
    together, alone = LargestDifference(), LargestDifference()
    for batch in batches(observations):
        _compare(together, network, single, batch)
    for row in observations[:ALONE, None]:
        _compare(alone, network, single, row)
    name = "logits" if policy.head == "discrete" else "actions"
    return [
        _check(f"{name}: torch = ONNX Runtime", together, len(observations)),
        _check(f"{name}, one at a time", alone, min(ALONE, len(observations))),
    ]


def _check(name: str, difference: LargestDifference, count: int) -> ParityCheck:
    largest = f"largest difference {difference.largest:.1e}, limit {TOLERANCE:.0e}"
    detail = f"{count:,} observations, {largest}"
    return ParityCheck(name, difference.within(TOLERANCE), detail)


def _compare(
    difference: LargestDifference,
    network: Any,  # noqa: ANN401
    policy: Policy,
    observation: NDArray[np.float64],
) -> None:
    seen = observation.astype(np.float32)
    found: Single = network.run([OUTPUTS[policy.head]], {OBSERVATION: seen})[0]
    expected = _output(policy, torch.from_numpy(seen))
    unit = np.maximum(1, np.abs(expected).max())
    difference.add(found / unit, expected / unit)


@torch.no_grad()
def _output(policy: Policy, observation: torch.Tensor) -> Single:
    forward = policy.scores if policy.head == "discrete" else policy
    output: Single = forward(observation).numpy()
    return output
