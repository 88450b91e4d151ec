"""Sigma-delta neurons: what a file says of a NIR node `I` that is more than an integrator.

    sigma[t] = sigma[t-1] + x[t]              the `I`; x are weights times graded spikes
    a = max(sigma + bias, 0)
    e = a / threshold - q                     q: graded spikes sent so far, added up
    k = sign(e) floor(|e| + 1/2) where |e| >= 1, else 0 ;  q = q + k

k is sent: a signed whole number. The weights behind it count it in thresholds, so they hold the
threshold as a factor. Nothing is sent while the activation is less than a threshold away from what
was sent, as in lava (proc.sdn: |delta| >= vth). lava sends the rest at once in units of a power of
two, rounded down; here the unit is the threshold, to the nearest (after O'Connor and Welling 2017).

NIR has no such node. A tool that does not read the metadata sees the integrator alone.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import nir
import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.errors import ArtifactError
from spikedeploy.runtime.metadata import Record, Tree

GRADED_MOST = 2**53  # of a graded spike in floats: whole numbers up to it are exact in float64

Floats = NDArray[np.float64]

_REMARK = (
    "a = max(sigma + bias, 0), sigma the membrane of this I; it sends k = round(a / threshold - q) "
    "where that is at least 1 either way, q the sum of all k; tools that do not read this see an "
    "integrator"
)


@dataclass(frozen=True, eq=False)
class SigmaDelta:
    """The neurons of one node.

    threshold: (N,) or the node's shape; distance that a graded spike of 1 stands for, above 0.
    bias: of the same shape, added to sigma before the rectification.
    """

    threshold: Floats
    bias: Floats

    def __post_init__(self) -> None:
        if self.threshold.shape != self.bias.shape:
            raise ArtifactError(
                f"sigma-delta neurons: threshold has shape {self.threshold.shape}, bias "
                f"{self.bias.shape}. Give one of each for each neuron."
            )
        if not (self.threshold > 0).all():
            raise ArtifactError(
                f"sigma-delta neurons: threshold holds {self.threshold.min():g}; each must be "
                "above 0. Export the policy again."
            )

    def to_record(self) -> Tree:
        """The fields as the file stores them."""
        return {"threshold": self.threshold, "bias": self.bias, "remark": _REMARK}

    @classmethod
    def from_record(cls, record: Record) -> "SigmaDelta":
        """The neurons stored in a file."""
        record.only("threshold", "bias", "remark")
        threshold = record.array("threshold")
        return cls(threshold, record.array("bias"))


def check_sigma_delta(graph: nir.NIRGraph, neurons: Mapping[str, SigmaDelta]) -> None:
    """Refuse sigma-delta neurons whose node is none, or has another shape."""
    for name, each in sorted(neurons.items()):
        node = graph.nodes.get(name)
        if not isinstance(node, nir.I):
            found = "there is no such node" if node is None else f"it is {type(node).__name__}"
            raise ArtifactError(
                f"node {name!r}: the metadata call it sigma-delta neurons, which NIR node I holds; "
                f"{found}. Export the policy again."
            )
        if each.threshold.shape != node.r.shape:
            raise ArtifactError(
                f"node {name!r}: its sigma-delta thresholds have shape {each.threshold.shape}, the "
                f"node {node.r.shape}. Export the policy again."
            )
