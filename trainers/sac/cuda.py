"""Gradient updates on a GPU: the update of a small network as one CUDA graph.

An update of soft actor-critic is some hundred small kernels, whose launches take longer than they
compute. Captured once, the graph launches them all; its inputs lie in tensors that keep their place
(https://docs.pytorch.org/docs/stable/notes/cuda.html#cuda-graphs). Nothing waits for the GPU: the
replay has a copy there, and actions come from a copy of the actor on the CPU, which is refreshed
when a transfer of the parameters has ended, a few updates late.
"""

import copy
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from spikedeploy.runtime.errors import ConfigError
from spikedeploy.trainers.policies.policy import Moments, Policy
from spikedeploy.trainers.sac.learner import (
    GaussianActor,
    ReplayBatch,
    ReplayBuffer,
    SacConfig,
    SacLearner,
)

_LATE = 8  # steps of the environments that actions may be behind a transfer
_EAGER = 3  # updates before the capture, in which PyTorch sets up what cannot be captured


class CudaReplay(ReplayBuffer):
    """A replay buffer with a copy on the GPU; the batches that it returns share one place."""

    def __init__(self, capacity: int, observations: int, actions: int) -> None:
        super().__init__(capacity, observations, actions)
        self._copy = torch.zeros(self.rows.shape, device="cuda")
        self._drawn = torch.zeros((0, self.rows.shape[1]), device="cuda")

    def _store(self, places: NDArray[np.int64], rows: NDArray[np.float64]) -> None:
        super()._store(places, rows)
        self._copy.index_copy_(0, _on_gpu(places), _on_gpu(self.rows[places]))

    def sample(self, count: int, rng: np.random.Generator) -> ReplayBatch:
        """Return transitions drawn uniformly with replacement."""
        if len(self._drawn) != count:
            self._drawn = self._copy.new_zeros((count, self._copy.shape[1]))
        places = _on_gpu(rng.integers(self.size, size=count))
        torch.index_select(self._copy, 0, places, out=self._drawn)
        return self.split(self._drawn)

    def load(self, path: Path, checksum: str) -> None:
        """Load the transitions of a file with this checksum; the newest where they are too many."""
        super().load(path, checksum)
        self._copy.copy_(torch.from_numpy(self.rows))


class CudaLearner(SacLearner):
    """A SacLearner whose networks are on the GPU; `policy`, which is saved, is on the CPU."""

    def __init__(self, config: SacConfig, policy: Policy) -> None:
        if not torch.cuda.is_available():
            raise ConfigError("device: this PyTorch finds no CUDA device; set device=cpu")
        super().__init__(config, policy)
        self._mean_policy = copy.deepcopy(policy).to("cuda")
        self._follower = _Follower(self.actor)
        for module in self.modules.values():
            module.to("cuda")
        self._optimise()
        self._scheduled = torch.zeros((), device="cuda")
        self._graph: torch.cuda.CUDAGraph | None = None
        self._losses: dict[str, Tensor] = {}
        self._eager = 0

    @property
    def _averaged(self) -> Policy:
        return self._mean_policy

    def adopt(self, moments: Moments) -> None:
        """Normalise observations by these statistics."""
        super().adopt(moments)
        self._follower.actor.policy.normalizer.adopt(moments)

    @property
    def _acting(self) -> GaussianActor:
        """A recent copy of the actor."""
        self._follower.follow(self.actor)
        return self._follower.actor

    def settle(self) -> None:
        """Copy the averaged policy from the GPU."""
        self.policy.load_state_dict(self._mean_policy.state_dict())

    def update(self, batch: ReplayBatch, temperature: float) -> dict[str, Tensor]:
        """Take one gradient step on a batch of a CudaReplay, and return the losses."""
        self._scheduled.fill_(temperature)
        if self._graph is not None:
            self._graph.replay()
        elif self._eager < _EAGER:
            self._losses = self._eagerly(batch)
        else:
            self._capture(batch)
        return self._losses

    def _eagerly(self, batch: ReplayBatch) -> dict[str, Tensor]:
        self._eager += 1
        stream: torch.cuda.Stream = torch.cuda.Stream()  # type: ignore[no-untyped-call]
        stream.wait_stream(torch.cuda.current_stream())
        with torch.cuda.stream(stream):  # not the default one, on which nothing can be captured
            losses = self._step(batch, self._entropy_weight())
        torch.cuda.current_stream().wait_stream(stream)
        return losses

    def _capture(self, batch: ReplayBatch) -> None:
        """Record the update, and run it for the first time."""
        graph = torch.cuda.CUDAGraph()
        with torch.cuda.graph(graph):
            self._losses = self._step(batch, self._entropy_weight())
        graph.replay()
        self._graph = graph

    def _entropy_weight(self) -> Tensor:
        if self.temperature is None:
            return self._scheduled
        return self.temperature.logarithm.detach().exp()

    def tensors(self) -> dict[str, Tensor]:
        """Return all tensors of a checkpoint except the policy's, by name, on the CPU."""
        return {name: tensor.cpu() for name, tensor in super().tensors().items()}

    def load(self, named: Mapping[str, Tensor]) -> None:
        """Restore the tensors of a checkpoint, the policy's under "policy." included."""
        super().load(named)
        self._mean_policy.load_state_dict(self.policy.state_dict())
        self._follower.actor.load_state_dict(self.actor.state_dict())


class _Follower:
    """A copy of the actor on the CPU, which follows the one on the GPU a little late.

    actor: the copy
    """

    def __init__(self, actor: GaussianActor) -> None:
        self.actor = copy.deepcopy(actor)
        count = sum(p.numel() for p in actor.parameters())
        self._pinned = torch.empty(count, pin_memory=True)
        self._sent: Any = None  # torch.cuda.Event, which has no types
        self._late = 0

    @torch.no_grad()
    def follow(self, source: GaussianActor) -> None:
        """Take over the parameters that have arrived, and send for newer ones."""
        if self._sent is not None:
            self._late += 1
            if self._late >= _LATE:
                self._sent.synchronize()
            if not self._sent.query():
                return
            nn.utils.vector_to_parameters(self._pinned.clone(), self.actor.parameters())
        flat = nn.utils.parameters_to_vector(source.parameters())
        self._pinned.copy_(flat, non_blocking=True)
        self._sent, self._late = torch.cuda.Event(), 0  # type: ignore[no-untyped-call]
        self._sent.record()


def _on_gpu(array: NDArray[np.float32] | NDArray[np.int64]) -> Tensor:
    # from memory that is not pinned CUDA copies to its own buffer first, so the array may change
    return torch.from_numpy(array).to("cuda", non_blocking=True)
