"""Parity of an ONNX file: ONNX Runtime must act as the policy does in torch."""

from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from exporters.check import Check, Gap, batches
from exporters.onnx_graph import ACTION, OBSERVATION
from trainers.onnx_session import session
from trainers.policies import Policy

TOLERANCE = 1e-5  # of an action in [-1, 1]: float32 sums in another order
ALONE = 100  # observations that are also given one at a time, as a robot does

Single = NDArray[np.float32]


def onnx_checks(policy: Policy, path: Path, observations: NDArray[np.float64]) -> list[Check]:
    """Return the checks of the file on observations (n, obs)."""
    single = deepcopy(policy).float()
    network = session(path)
    together, alone = Gap(), Gap()
    for batch in batches(observations):
        together.add(_run(network, batch), _act(single, batch))
    for row in observations[:ALONE, None]:
        alone.add(_run(network, row), _act(single, row))
    return [
        _check("actions: torch = ONNX Runtime", together, len(observations)),
        _check("actions, one at a time", alone, min(ALONE, len(observations))),
    ]


def _check(name: str, gap: Gap, count: int) -> Check:
    detail = f"{count:,} observations, largest difference {gap.largest:.1e}, limit {TOLERANCE:.0e}"
    return Check(name, gap.within(TOLERANCE), detail)


def _run(network: Any, observation: NDArray[np.float64]) -> Single:  # noqa: ANN401
    action: Single = network.run([ACTION], {OBSERVATION: observation.astype(np.float32)})[0]
    return action


@torch.no_grad()
def _act(policy: Policy, observation: NDArray[np.float64]) -> Single:
    action: Single = policy(torch.from_numpy(observation).float()).numpy()
    return action
