"""Configuration of PPO after imitation."""

from typing import Literal

from pydantic import Field, model_validator

from spikedeploy.trainers.config import (
    Batch,
    Count,
    DeltaSnnConfig,
    PolicyConfig,
    Positive,
    Rate,
    RunConfig,
    Share,
    ValidationConfig,
    Width,
)

Ends = tuple[Rate, Rate]


class SparsePpoConfig(RunConfig):
    """PPO on windows of whole walks, from the best policy of a sparse run (docs/training.md).

    start: run folder of a sparse recipe: a path, or a name in the folder that this run is in.
        Policy, masks, teacher, budget, chip, rounding and sharpness are those of its configuration
    start_checkpoint: which of its policies: "best" is the best at its budget, "ops-480" the best of
        those pruned to 480 operations, which then are the budget
    budget: operations of a control step that the best policy may take; by default those of the
        start's recipe, or what the start takes if that is more
    iterations: number of times that episodes are played and learned from; `validation.every` and
        `checkpoint_every` count them
    warm_up: iterations at the beginning in which only the critic learns
    episodes: whole episodes of an iteration, played at once
    noise: standard deviation of the noise on continuous actions, in the first and last iteration
    temperature: divisor of the logits when discrete actions are sampled, in the same way
    window, burn_in: control steps of a window of a walk, and how many of them at its beginning only
        bring the states up, which are learned from in the window before
    batch, epochs: windows of an update, and passes over those of an iteration
    learns: which weights: "all", or those onto the readout and its decay factors alone. Then the
        hidden spikes of a replayed walk stay what they were, and the ratios change smoothly; the
        penalty has no effect
    gamma, trace, clip, gradient_norm: as of PPO, see PpoConfig
    actor_rate, target_kl: learning rate of the policy in the first pass, and the mean divergence
        from the policy that played which it is adapted to: a pass that ends above twice as much is
        the last one of its iteration and lowers the rate, one below half as much raises it (Rudin
        et al. 2022)
    critic_rate, critic_batch, critic_epochs, critic_hidden: of the critic, which learns from single
        states
    imitation: weight of the error against the teacher's labels
    penalty: weight of the hidden neurons' operations over `max(budget, penalty_floor)` of the start
    """

    policy: PolicyConfig = DeltaSnnConfig()
    start: str = ""
    start_checkpoint: str = "best"
    budget: Rate | None = None
    iterations: Positive = 60
    warm_up: Count = 2
    episodes: Positive = 8
    noise: Ends = (0.2, 0.1)
    temperature: Ends = (1.0, 0.2)
    window: Batch = 60
    burn_in: Count = 15
    batch: Batch = 32
    epochs: Positive = 4
    learns: Literal["all", "readout"] = "readout"
    gamma: Share = 0.98
    trace: Share = 0.95
    clip: Rate = 0.2
    target_kl: Rate = 0.01
    gradient_norm: Rate = 0.5
    actor_rate: Rate = 5e-5
    critic_rate: Rate = 1e-3
    critic_batch: Batch = 512
    critic_epochs: Positive = 8
    critic_hidden: tuple[Width, ...] = (128, 128)
    imitation: float = Field(default=1.0, ge=0)
    penalty: float = Field(default=0.1, ge=0)
    checkpoint_every: Positive = 10
    validation: ValidationConfig = ValidationConfig(every=10, episodes=24)

    @model_validator(mode="after")
    def _windows_follow_each_other(self) -> "SparsePpoConfig":
        if self.window < 2 * self.burn_in or self.window == self.burn_in:
            raise ValueError(f"window: {self.window} is less than twice burn_in ({self.burn_in})")
        return self
