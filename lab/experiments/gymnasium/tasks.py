"""Tasks of the gymnasium experiment, and the dense PopSAN beside which operations are counted."""

from collections.abc import Sequence
from dataclasses import dataclass

# a PopSAN as published for these tasks (Tang et al. 2020)
_WIDTH, _POPULATION, TIMESTEPS = 256, 10, 5
RATE = 0.15  # of a dense network that is not trained here: spikes of a neuron and timestep

_SAC = ("learn_temperature=true", "policy.hidden=[256,256]", "critic_hidden=[256,256]", "batch=256")
_MUJOCO = (
    *_SAC, "steps=1000000", "update_every=2", "learning_rate=3e-4", "env.count=4", "warm_up=10000",
    "validation.every=25000", "checkpoint_every=2000000",
)  # fmt: skip
# fast changes need finer and more events than walking does
_FINE = ("policy.hidden=128", "policy.most=8", "policy.integrated=true", "step=0.25")
# episodes of 1,000 steps: more states, and validations that are not most of the time
_DENSE = ("iterations=6", "states=10000", "updates=8000", "validation.every=1000")
# longer with reward, of all weights, and further from the teacher
_REWARD = ("iterations=160", "learns=all", "imitation=0.1")


@dataclass(frozen=True)
class Task:
    """A task of gymnasium.

    env                    its id
    observations, actions  their numbers
    recipe, settings       of the teacher
    student                settings of the sparse spiking policy
    baseline               settings of the float MLP
    budget                 operations of a control step of both
    dense                  settings of the dense PopSAN
    reward                 settings of the student's training with reward
    wanted                 return on the chip that is asked for; None for a share of the teacher's
    """

    env: str
    observations: int
    actions: int
    recipe: str
    settings: Sequence[str]
    student: Sequence[str]
    baseline: Sequence[str]
    budget: float
    wanted: float | None = None
    dense: Sequence[str] = ()
    reward: Sequence[str] = ()

    @property
    def continuous(self) -> bool:
        """Whether actions are continuous, as SAC and PopSAN need them."""
        return self.recipe == "sac-mlp"

    @property
    def synapses(self) -> int:
        """Synapses of the dense PopSAN: encoder onto 256, onto 256, onto the coded actions."""
        first, last = _POPULATION * self.observations, _POPULATION * self.actions
        return first * _WIDTH + _WIDTH * _WIDTH + _WIDTH * last

    def dense_operations(self, rate: float = RATE) -> float:
        """SOPs of its control step where each neuron spikes with this rate."""
        # SOPs = T rate sum(fan-outs)
        return TIMESTEPS * rate * self.synapses


TASKS = {
    task.env: task
    for task in (
        Task(
            "CartPole-v1", 4, 2, "ppo-mlp", (),
            ("policy.hidden=16",), ("policy.hidden=[16]",), 40, 475,
        ),
        Task(
            "Pendulum-v1", 3, 1, "sac-mlp", (*_SAC, "steps=20000"),
            ("policy.hidden=32",), ("policy.hidden=[32]",), 60, -200,
        ),
        Task("Hopper-v5", 11, 3, "sac-mlp", _MUJOCO, _FINE, (), 600, dense=_DENSE),
        Task("HalfCheetah-v5", 17, 6, "sac-mlp", _MUJOCO, _FINE, (), 900, dense=_DENSE),
        Task(
            "Ant-v5", 105, 8, "sac-mlp", _MUJOCO, _FINE, (), 2_400, dense=_DENSE, reward=_REWARD,
        ),
    )
}  # fmt: skip
