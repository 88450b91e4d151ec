"""Configuration of proximal policy optimisation."""

from pydantic import Field, model_validator

from spikedeploy.trainers.config import (
    Batch,
    Count,
    EnvConfig,
    MlpConfig,
    NormaliserConfig,
    Positive,
    Ramp,
    Rate,
    RunConfig,
    Share,
    ValidationConfig,
    Width,
)

HOLDS = 2  # validations in a row, so that greedy driving that swings is no success


class PpoConfig(RunConfig):
    """Proximal policy optimisation with a clipped surrogate (Schulman et al. 2017).

    steps: environment steps in total, of all copies together
    horizon: steps of each copy between two updates; a batch has `env.count` times as many
    epochs, minibatch: passes over a batch, and rows per gradient update
    trace: lambda of generalised advantage estimation
    clip: limit on the change of an action's probability ratio
    entropy: weight of the policy's entropy in its loss, along environment steps
    temperature: divisor of a discrete head's logits when actions are sampled, along environment
        steps. It ends low, so that training visits the states that greedy actions lead to, such as
        turning left and right forever, which a policy that samples its actions never does
    target_kl: mean divergence from the acting policy after which the epochs end; 0 for no limit
    gradient_norm: limit on the norm of the gradient, for actor and critic each
    actor_rate: learning rate of the policy, along environment steps
    critic_rate: learning rate of the critic
    spread: initial standard deviation of a continuous head's exploration, before tanh
    rate_penalty, rate_target: weight and threshold of the hinge on mean firing rates [spikes per
        neuron and timestep]; no effect on an MLP
    stop_at_finishes: finished episodes after which training ends; 0 for no limit
    stop_at_greedy: share of validation episodes that must finish, twice in a row, for training to
        end; 0 for no limit. With both limits it ends when both are reached
    running_total: whether every step pays the sum of its episode's rewards so far, as the
        environments of kart-simulator do; returns in logs stay those of the environment
    ghosts: whether training episodes are saved for `replay`, in environments with poses
    """

    env: EnvConfig = EnvConfig(name="kart-grid", count=16)
    normaliser: NormaliserConfig = NormaliserConfig(finish=0)
    validation: ValidationConfig = ValidationConfig(every=20_000, episodes=20)
    steps: Positive = 300_000
    horizon: Batch = 128
    epochs: Positive = 6
    minibatch: Batch = 256
    gamma: Share = 0.99
    trace: Share = 0.95
    clip: Rate = 0.2
    entropy: Ramp = Ramp(start=0.01, end=0.0, finish=200_000)
    temperature: Ramp = Ramp(start=1.0, end=0.1, begin=120_000, finish=200_000)
    target_kl: float = Field(default=0.03, ge=0)
    gradient_norm: Rate = 0.5
    actor_rate: Ramp = Ramp(start=1e-3, end=0.0, finish=300_000)
    critic_rate: Rate = 1e-3
    critic_hidden: tuple[Width, ...] = (128, 128)
    spread: Rate = 0.6
    rate_penalty: float = Field(default=0.0, ge=0)
    rate_target: Share = 0.2
    stop_at_finishes: Count = 0
    stop_at_greedy: Share = 0.0
    running_total: bool = False
    ghosts: bool = True
    checkpoint_every: Positive = 50_000

    @model_validator(mode="after")
    def _observes_everything(self) -> "PpoConfig":
        if isinstance(self.policy, MlpConfig) and self.policy.features != "all":
            raise ValueError("ppo learns from all observations: distil policies that observe less")
        return self

    def reached(self, finishes: int, held: int) -> bool:
        """Return whether training may end before its last step: every limit that is set is reached.

        finishes: finished episodes of training
        held: latest validations in a row with at least `stop_at_greedy`
        """
        limits = []
        if self.stop_at_finishes:
            limits.append(finishes >= self.stop_at_finishes)
        if self.stop_at_greedy:
            limits.append(held >= HOLDS)
        return bool(limits) and all(limits)
