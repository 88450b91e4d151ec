"""Gradient updates on a GPU: the update of a small network as one CUDA graph.

An update of soft actor-critic is some hundred small kernels, whose launches take longer than they
compute. Captured once, the graph launches them all; its inputs lie in tensors that keep their place
(https://docs.pytorch.org/docs/stable/notes/cuda.html#cuda-graphs).
"""

import copy
from dataclasses import fields

import torch
from torch import Tensor

from spikedeploy.runtime.errors import ConfigError
from spikedeploy.trainers.adam import adam
from spikedeploy.trainers.policies.policy import Policy
from spikedeploy.trainers.sac.config import SacConfig
from spikedeploy.trainers.sac.learner import SacLearner
from spikedeploy.trainers.sac.replay import ReplayBatch

_EAGER = 3  # updates before the capture, in which PyTorch sets up what cannot be captured


class CudaLearner(SacLearner):
    """A SacLearner whose networks are on the GPU; `policy`, which is saved, is on the CPU."""

    def __init__(self, config: SacConfig, policy: Policy) -> None:
        if not torch.cuda.is_available():
            raise ConfigError("device: this PyTorch finds no CUDA device; set device=cpu")
        super().__init__(config, policy)
        self._mean_policy = copy.deepcopy(policy).to("cuda")
        for module in self._modules().values():
            module.to("cuda")
        self._optimise()
        self._batch: ReplayBatch | None = None
        self._scheduled = torch.zeros((), device="cuda")
        self._graph: torch.cuda.CUDAGraph | None = None
        self._losses: dict[str, Tensor] = {}
        self._eager = 0

    @property
    def _averaged(self) -> Policy:
        return self._mean_policy

    def settle(self) -> None:
        """Copy the averaged policy from the GPU."""
        self.policy.load_state_dict(self._mean_policy.state_dict())

    def update(self, batch: ReplayBatch, temperature: float) -> dict[str, Tensor]:
        """Take one gradient step and return the losses."""
        held = self._hold(batch)
        self._scheduled.fill_(temperature)
        if self._graph is not None:
            self._graph.replay()
        elif self._eager < _EAGER:
            self._losses = self._eagerly(held)
        else:
            self._capture(held)
        return self._losses

    def _hold(self, batch: ReplayBatch) -> ReplayBatch:
        """Return the batch on the GPU, always in the same place."""
        if self._batch is None:
            parts = {f.name: getattr(batch, f.name).to("cuda") for f in fields(batch)}
            self._batch = ReplayBatch(**{k: v.contiguous() for k, v in parts.items()})
        for field in fields(batch):
            getattr(self._batch, field.name).copy_(getattr(batch, field.name))
        return self._batch

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

    def load(self, named: dict[str, Tensor]) -> None:
        """Restore the tensors of a checkpoint, the policy's under "policy." included."""
        super().load(named)
        self._mean_policy.load_state_dict(self.policy.state_dict())
