"""The settings that training has: one model for each group, with defaults and limits."""

from typing import Annotated, Any, Literal

from pydantic import AliasChoices, BaseModel, ConfigDict, Field, model_validator

Positive = Annotated[int, Field(gt=0)]
Count = Annotated[int, Field(ge=0)]
Rate = Annotated[float, Field(gt=0)]
Share = Annotated[float, Field(ge=0, le=1)]


class Section(BaseModel):
    """A group of settings: frozen, and it refuses what it does not know."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class Ramp(Section):
    """A number that moves linearly from `start` to `end` between two environment steps."""

    start: float
    end: float
    begin: Count = 0
    finish: Count

    def at(self, step: int) -> float:
        """Return the value at an environment step."""
        span = max(self.finish - self.begin, 1)
        share = min(max((step - self.begin) / span, 0.0), 1.0)
        return self.start + (self.end - self.start) * share


class EnvConfig(Section):
    """The world: short name or id, options of its constructor, copies stepped as one batch."""

    name: str = "hexapod"
    options: dict[str, Any] = Field(default_factory=dict)
    count: Positive = 4


class MlpConfig(Section):
    """A float network; no hidden layers make it a linear policy."""

    kind: Literal["mlp"] = "mlp"
    hidden: tuple[Positive, ...] = (512, 512)
    features: Literal["all", "phase", "bilinear"] = "all"

    @property
    def spiking_layers(self) -> int:
        """How many layers spike, the encoder not counted."""
        return 0


class PopsanConfig(Section):
    """A population-coded spiking actor (Tang et al. 2020), with the hexapod's decays."""

    kind: Literal["popsan"] = "popsan"
    hidden: tuple[Positive, ...] = (512, 512)
    populations: Positive = 10
    timesteps: Positive = 5
    alpha: Share = 0.9
    beta: Share = 0.8
    threshold: Rate = 0.5
    surrogate: Literal["atan", "rectangular"] = "atan"
    surrogate_width: Rate | None = None  # None: 2.0 for atan (alpha), 0.5 for rectangular

    @property
    def spiking_layers(self) -> int:
        """How many layers spike, the encoder not counted; the last one speaks for the actions."""
        return len(self.hidden) + 1


class SpikingMlpConfig(Section):
    """Layers of LIF neurons and a linear readout of their mean spikes, as kart-simulator's.

    coding: how a number in [-1, 1] becomes spikes: "regular" and "bernoulli" are rate codes, evenly
        spaced or at random; "population" is PopSAN's, `populations` neurons for each number
    """

    kind: Literal["spiking-mlp"] = "spiking-mlp"
    hidden: tuple[Positive, ...] = Field(default=(64, 64), min_length=1)
    coding: Literal["regular", "bernoulli", "population"] = "regular"
    populations: Positive = 4
    timesteps: Positive = 16
    beta: Share = 0.9
    threshold: Rate = 0.7
    surrogate: Literal["fast-sigmoid", "atan", "rectangular"] = "fast-sigmoid"
    surrogate_width: Rate | None = None  # None: 25 for fast-sigmoid, others as in PopsanConfig

    @property
    def spiking_layers(self) -> int:
        """How many layers spike, the encoder not counted."""
        return len(self.hidden)


PolicyConfig = Annotated[MlpConfig | PopsanConfig | SpikingMlpConfig, Field(discriminator="kind")]


class NormaliserConfig(Section):
    """Observation statistics: gathered up to `finish` environment steps, then frozen."""

    finish: Count = 60_000
    clip: Rate = 4.0


class ValidationConfig(Section):
    """Deterministic episodes, without support, that choose the best checkpoint.

    every: environment steps between two validations
    first_seed: episodes use this seed and those after it; 5,000 to 9,999 are kept for this
    limit: control steps after which an episode is cut, None for the environment's own
    """

    every: Positive = 10_000
    episodes: Positive = 4
    first_seed: int = Field(default=5_000, ge=5_000, lt=9_000)
    limit: Positive | None = None


class RunConfig(Section):
    """What every algorithm's configuration holds."""

    algorithm: str
    recipe: str
    seed: int = Field(default=0, ge=0)
    env: EnvConfig = EnvConfig()
    policy: PolicyConfig = MlpConfig()
    normaliser: NormaliserConfig = NormaliserConfig()
    validation: ValidationConfig = ValidationConfig()


class SacConfig(RunConfig):
    """Soft actor-critic with a temperature that is set, not learned (Haarnoja et al. 2018).

    steps: environment steps in all; 500 episodes of 1,000
    warm_up: steps with uniform random actions before the first update
    update_every: environment steps per gradient update
    epsilon: added inside the logarithm of the tanh correction
    averaging: share of the newest weights in the averaged policy, which is the one that is
        validated and kept; 1 keeps the actor's own
    mean_penalty: weight of the squared pre-tanh mean in the actor's loss
    rate_penalty, rate_target: weight and threshold of the hinge on mean firing rates [spikes per
        neuron and timestep]; no effect on an MLP
    support_force: fraction of the full upward force
    """

    steps: Positive = 500_000
    warm_up: Positive = 10_000
    update_every: Positive = 4
    batch: Positive = 128
    buffer: Positive = 1_000_000
    critic_hidden: tuple[Positive, ...] = (512, 512)
    learning_rate: Rate = 3e-4
    gamma: Share = 0.99
    tau: Share = 0.005
    temperature: Ramp = Ramp(start=0.05, end=0.02, begin=50_000, finish=180_000)
    epsilon: Rate = 1e-6
    averaging: Share = 1e-4
    mean_penalty: float = Field(default=0.05, ge=0)
    rate_penalty: float = Field(default=0.0, ge=0)
    rate_target: Share = 0.13
    support_force: Ramp = Field(
        default=Ramp(start=1.0, end=0.0, finish=150_000),
        # run folders before version 0.2 call it hoist
        validation_alias=AliasChoices("support_force", "hoist"),
    )
    precision: Literal["float32", "bfloat16"] = "bfloat16"
    log_every: Positive = 1_000
    checkpoint_every: Positive = 25_000

    @model_validator(mode="after")
    def _sees_everything(self) -> "SacConfig":
        if isinstance(self.policy, MlpConfig) and self.policy.features != "all":
            raise ValueError("sac learns from all observations: distil policies that see less")
        return self
