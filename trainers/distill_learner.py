"""One gradient update of a student towards its teacher."""

import math
from collections.abc import Iterable

import torch
from torch import Tensor

from spikedeploy.trainers import adam
from spikedeploy.trainers.distill_config import DistillConfig
from spikedeploy.trainers.policy import Policy
from spikedeploy.trainers.popsan import PopsanPolicy
from spikedeploy.trainers.rates import excess, mean_over_time, mean_rate


class DistillLearner:
    """A student and its optimiser.

    student: the policy that learns
    """

    def __init__(self, config: DistillConfig, student: Policy) -> None:
        self._config = config
        self.student = student
        self.optimizer = adam.adam(student, config.learning_rate)

    def update(self, observation: Tensor, label: Tensor, progress: float) -> dict[str, Tensor]:
        """Take one gradient step towards labels (B, act); `progress` runs from 0 to 1."""
        # lr = lr_0 (1 + cos(pi progress)) / 2
        rate = self._config.learning_rate * 0.5 * (1 + math.cos(math.pi * progress))
        for group in self.optimizer.param_groups:
            group["lr"] = rate
        action, penalty = self._act(observation)
        error = (action - label).square().mean()
        self.optimizer.zero_grad()
        (error + penalty).backward()  # type: ignore[no-untyped-call]
        self.optimizer.step()
        return {"loss": error.detach(), "rate_penalty": penalty.detach()}

    def _act(self, observation: Tensor) -> tuple[Tensor, Tensor]:
        """Return the student's actions (B, act), and what its spikes cost."""
        enabled = self._config.precision == "bfloat16"
        with torch.autocast("cpu", dtype=torch.bfloat16, enabled=enabled):
            if not isinstance(self.student, PopsanPolicy):
                latent = self.student.latent(observation)
                return self.student.decide(latent.mean), self._penalty((), latent.rates)
            spikes = self.student.spikes(observation)
            action = torch.tanh(self.student.decode(mean_over_time(spikes[-1])))
        encoder, *layers = (mean_rate(raster) for raster in spikes)
        return action, self._penalty([encoder], layers)

    def _penalty(self, encoders: Iterable[Tensor], layers: Iterable[Tensor]) -> Tensor:
        """Return what mean firing rates above their targets cost."""
        config = self._config
        inputs = config.input_penalty * excess(encoders, config.input_target)
        return inputs + config.rate_penalty * excess(layers, config.rate_target)

    def tensors(self) -> dict[str, Tensor]:
        """Return what a checkpoint needs beside the student."""
        state = adam.tensors(self.optimizer)
        return {f"adam.{name}": value for name, value in state.items()}

    def load(self, tensors: dict[str, Tensor]) -> None:
        """Take over the tensors of a checkpoint, the student's under "policy." among them."""
        self.student.load_state_dict(adam.under("policy", tensors))
        adam.load(self.optimizer, adam.under("adam", tensors))
