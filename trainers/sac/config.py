"""Configuration of soft actor-critic."""

from typing import Literal

from pydantic import Field, model_validator

from spikedeploy.trainers.config import (
    Batch,
    Kept,
    MlpConfig,
    Positive,
    Ramp,
    Rate,
    RunConfig,
    Share,
    Width,
)


class SacConfig(RunConfig):
    """Soft actor-critic with a scheduled or a learned temperature (Haarnoja et al. 2018).

    steps: environment steps in total; 500 episodes of 1,000
    warm_up: steps with uniform random actions before the first update
    update_every: environment steps per gradient update
    temperature: weight of the entropy, along environment steps
    learn_temperature: begin with `temperature.start` and learn it instead, so that the mean entropy
        of the actor is minus one nat for each action (Haarnoja et al. 2018, "Algorithms and
        Applications", section 5): it follows the size of the rewards
    epsilon: added inside the logarithm of the tanh correction
    averaging: weight of the newest parameters in the averaged policy, which is validated and
        saved; 1 saves the actor's own
    mean_penalty: weight of the squared pre-tanh mean in the actor's loss
    smoothness: weight of the squared change of the policy's action, summed over actions, from each
        state to the following one, in the actor's loss (Mysore et al. 2021, temporal term)
    shaping: extra weights of reward terms by name, in training only: updates see
        reward + sum of weight x term, so {"power": 2} counts power three times. Validation,
        metrics and the choice of the best checkpoint stay with the environment's own reward
    rate_penalty, rate_target: weight and threshold of the hinge on mean firing rates [spikes per
        neuron and timestep]; no effect on an MLP
    device: where gradients are computed; environments and validation stay on the CPU. "cuda" is
        worth it from layers of 256 on, and does not give the same bits twice
    support_force: fraction of the full upward force on the robot, along environment steps
    """

    steps: Positive = 500_000
    warm_up: Positive = 10_000
    update_every: Positive = 4
    batch: Batch = 128
    buffer: Kept = 1_000_000
    critic_hidden: tuple[Width, ...] = (512, 512)
    learning_rate: Rate = 3e-4
    gamma: Share = 0.99
    tau: Share = 0.005
    temperature: Ramp = Ramp(start=0.05, end=0.02, begin=50_000, finish=180_000)
    learn_temperature: bool = False
    epsilon: Rate = 1e-6
    averaging: Share = 1e-4
    mean_penalty: float = Field(default=0.05, ge=0)
    smoothness: float = Field(default=0.0, ge=0)
    shaping: dict[str, float] = Field(default_factory=dict)
    rate_penalty: float = Field(default=0.0, ge=0)
    rate_target: Share = 0.13
    support_force: Ramp = Ramp(start=1.0, end=0.0, finish=150_000)
    precision: Literal["float32", "bfloat16"] = "bfloat16"
    device: Literal["cpu", "cuda"] = "cpu"
    log_every: Positive = 1_000
    checkpoint_every: Positive = 25_000

    @model_validator(mode="after")
    def _begins_above_zero(self) -> "SacConfig":
        if self.learn_temperature and self.temperature.start <= 0:
            raise ValueError(
                f"temperature.start: {self.temperature.start:g} cannot be learned from, as its "
                "logarithm is: begin above 0, or set learn_temperature=false"
            )
        return self

    @model_validator(mode="after")
    def _computes_in_float32(self) -> "SacConfig":
        if self.device == "cuda" and self.precision != "float32":
            raise ValueError("device: cuda computes in float32 here: set precision=float32 as well")
        return self

    @model_validator(mode="after")
    def _observes_everything(self) -> "SacConfig":
        if isinstance(self.policy, MlpConfig) and self.policy.features != "all":
            raise ValueError("sac learns from all observations: distil policies that observe less")
        return self
