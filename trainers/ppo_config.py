"""The configuration of proximal policy optimisation."""

from pydantic import Field, model_validator

from spikedeploy.trainers.config import (
    Count,
    EnvConfig,
    MlpConfig,
    NormaliserConfig,
    Positive,
    Rate,
    RunConfig,
    Share,
    ValidationConfig,
)
from spikedeploy.trainers.settings import Ramp


class PpoConfig(RunConfig):
    """Proximal policy optimisation with a clipped surrogate (Schulman et al. 2017).

    steps: environment steps in all, all copies together
    horizon: steps of each copy between two updates; `env.count` times as many are a batch
    epochs, minibatch: passes over a batch, and rows of each gradient update
    clip: limit on the change of an action's probability ratio
    entropy: weight of the policy's entropy in its loss, along environment steps
    temperature: what a discrete head's logits are divided by before an action is drawn, along
        environment steps. In the end it is low, so that training meets what the best action alone
        leads to: turning left and right for ever, which a robot that draws its actions never does
    target_kl: mean divergence from the policy that acted after which the epochs end; 0 for never
    gradient_norm: limit on the norm of the gradient, of actor and critic each
    actor_rate: learning rate of the policy, along environment steps
    critic_rate: that of the critic
    spread: initial standard deviation of a continuous head's exploration, before tanh
    rate_penalty, rate_target: weight and threshold of the hinge on mean firing rates [spikes per
        neuron and timestep]; no effect on an MLP
    stop_at_finishes: finished episodes of training after which it ends; 0 for never
    ghosts: whether the episodes of training are kept for `replay`, where the world has poses
    """

    env: EnvConfig = EnvConfig(name="kart-grid", count=16)
    normaliser: NormaliserConfig = NormaliserConfig(finish=0)
    validation: ValidationConfig = ValidationConfig(every=20_000, episodes=20)
    steps: Positive = 300_000
    horizon: Positive = 128
    epochs: Positive = 6
    minibatch: Positive = 256
    gamma: Share = 0.99
    trace: Share = 0.95
    clip: Rate = 0.2
    entropy: Ramp = Ramp(start=0.01, end=0.0, finish=200_000)
    temperature: Ramp = Ramp(start=1.0, end=0.1, begin=120_000, finish=200_000)
    target_kl: float = Field(default=0.03, ge=0)
    gradient_norm: Rate = 0.5
    actor_rate: Ramp = Ramp(start=1e-3, end=0.0, finish=300_000)
    critic_rate: Rate = 1e-3
    critic_hidden: tuple[Positive, ...] = (128, 128)
    spread: Rate = 0.6
    rate_penalty: float = Field(default=0.0, ge=0)
    rate_target: Share = 0.2
    stop_at_finishes: Count = 0
    ghosts: bool = True
    checkpoint_every: Positive = 50_000

    @model_validator(mode="after")
    def _sees_everything(self) -> "PpoConfig":
        if isinstance(self.policy, MlpConfig) and self.policy.features != "all":
            raise ValueError("ppo learns from all observations: distil policies that see less")
        return self
