"""A student that learns from a pool of walks, and is pruned."""

from collections.abc import Mapping

import numpy as np
from torch import Tensor, nn

from spikedeploy.trainers import adam
from spikedeploy.trainers.policies.pruned import PrunedWeight
from spikedeploy.trainers.sparse.config import SparseConfig
from spikedeploy.trainers.sparse.pool import WalkPool
from spikedeploy.trainers.sparse.pruning import prune, remove_neurons
from spikedeploy.trainers.sparse.students import Student

_DENSE_BUDGET = 4_000.0  # operations for which the penalty is scaled while nothing is pruned
_REMOVED = 1  # neurons at most in one pruning


class SparseLearner:
    """Gradient updates of a student towards its teacher, and pruning by Adam's second moments.

    student: what learns
    """

    def __init__(self, config: SparseConfig, student: Student) -> None:
        self._config = config
        self.student = student
        self.restart()

    def restart(self) -> None:
        """Begin with a new optimiser."""
        self.optimizer = adam.adam(self.student.policy, self._config.learning_rate)

    def update(self, pool: WalkPool, rng: np.random.Generator, rate: float, dense: bool) -> float:
        """Take one gradient step, and return the error; `dense` before anything is pruned."""
        config = self._config
        for group in self.optimizer.param_groups:
            group["lr"] = rate
        error, hidden = self.student.loss(pool, rng)
        budget = _DENSE_BUDGET if dense else max(config.budget, config.penalty_floor)
        self.optimizer.zero_grad()
        (error + config.penalty * hidden / budget).backward()  # type: ignore[no-untyped-call]
        nn.utils.clip_grad_norm_(self.student.policy.parameters(), 1.0)
        self.optimizer.step()
        return float(error.detach())

    def prune(self, goal: float) -> None:
        """Take out synapses, and neurons that are not worth their updates, down to the goal."""
        squares = self._squares()
        if not squares:
            return
        for into, out in self.student.hidden_layers():
            remove_neurons(into, out, squares, self._config.neuron_cost, _REMOVED)
        prune(self.student.synapses(), squares, goal)

    def _squares(self) -> Mapping[PrunedWeight, Tensor]:
        """Adam's second moment of each weight; nothing before its first step."""
        matrices = [m for m in self.student.policy.modules() if isinstance(m, PrunedWeight)]
        state = self.optimizer.state
        return {m: state[m.weight]["exp_avg_sq"] for m in matrices if m.weight in state}

    def tensors(self) -> dict[str, Tensor]:
        """Return all tensors of a checkpoint except the policy's, by name."""
        state = adam.tensors(self.optimizer)
        own = {f"student.{name}": value for name, value in self.student.tensors().items()}
        return {**own, **{f"adam.{name}": value for name, value in state.items()}}

    def load(self, named: dict[str, Tensor]) -> None:
        """Restore the tensors of a checkpoint, the policy's under "policy." included."""
        self.student.policy.load_state_dict(adam.under("policy", named))
        self.student.load(adam.under("student", named))
        adam.load(self.optimizer, adam.under("adam", named))
