"""The configuration of distillation."""

from typing import Literal

from pydantic import Field

from spikedeploy.trainers.config import (
    NormaliserConfig,
    Positive,
    Rate,
    RunConfig,
    Share,
    ValidationConfig,
)


class DistillConfig(RunConfig):
    """A teacher's policy learned by DAgger (Ross et al. 2011).

    teacher: what is imitated: a run folder, or an .onnx or .nir file
    iterations: times that states are gathered, the first time along the teacher's own way
    states: environment steps of each iteration, all copies together
    updates: gradient updates in all, spread evenly over the iterations; `validation.every`,
        `log_every` and `checkpoint_every` count them
    mixing: share of the teacher's actions when gathering; iteration k has mixing ** k of them
    noise: standard deviation of Gaussian noise on the actions that are carried out, so that the
        states cover more than one way; labels are without it
    learning_rate: at the start; it falls to zero as half a cosine
    rate_penalty, rate_target: weight and threshold of the hinge on the mean firing rate of every
        spiking layer [spikes per neuron and timestep]; no effect on an MLP
    input_penalty, input_target: the same for the encoder's neurons, whose spikes cost the most
        synaptic operations
    """

    normaliser: NormaliserConfig = NormaliserConfig(finish=8_000)
    validation: ValidationConfig = ValidationConfig(every=500, episodes=8)
    teacher: str = ""
    iterations: Positive = 6
    states: Positive = 8_000
    updates: Positive = 6_000
    mixing: Share = 0.0
    noise: float = Field(default=0.0, ge=0)
    batch: Positive = 256
    learning_rate: Rate = 1e-3
    rate_penalty: float = Field(default=0.1, ge=0)
    rate_target: Share = 0.13
    input_penalty: float = Field(default=0.1, ge=0)
    input_target: Share = 0.13
    precision: Literal["float32", "bfloat16"] = "bfloat16"
    log_every: Positive = 100
    checkpoint_every: Positive = 1_000
