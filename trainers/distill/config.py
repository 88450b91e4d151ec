"""Configuration of distillation."""

from typing import Literal

from pydantic import Field

from spikedeploy.trainers.config import (
    Batch,
    Kept,
    NormaliserConfig,
    Positive,
    Rate,
    RunConfig,
    Share,
    ValidationConfig,
)


class DistillConfig(RunConfig):
    """Imitation of a teacher by DAgger (Ross et al. 2011).

    teacher: policy to imitate: a run folder, an .onnx, .nir or Stable-Baselines3 .zip file, or
        my_module:function (docs/own-teacher.md)
    teacher_units: of the actions of functions and of other people's .onnx files: "own" units of
        the environment, which is the default, or "scaled" to [-1, 1]
    iterations: number of times that states are collected, first with the teacher's own actions
    states: environment steps of each iteration, of all copies together
    updates: gradient updates in total, spread evenly over the iterations; `validation.every`,
        `log_every` and `checkpoint_every` count them
    mixing: share of the teacher's actions in collection, mixing ** k in iteration k
    noise: standard deviation of Gaussian noise on the executed actions, so that states cover more
        than one trajectory; labels are without it. Of discrete actions the share drawn at random
    sharpness: factor of the teacher's logits in the targets of discrete actions
    learning_rate: initial value, annealed to zero by a half cosine
    rate_penalty, rate_target: weight and threshold of the hinge on the mean firing rate of every
        spiking layer [spikes per neuron and timestep]; no effect on an MLP
    input_penalty, input_target: the same for the encoder's neurons, whose spikes cause the most
        synaptic operations
    """

    normaliser: NormaliserConfig = NormaliserConfig(finish=8_000)
    validation: ValidationConfig = ValidationConfig(every=500, episodes=8)
    teacher: str = ""
    teacher_units: Literal["own", "scaled"] | None = None
    iterations: Positive = 6
    states: Kept = 8_000
    updates: Positive = 6_000
    mixing: Share = 0.0
    noise: float = Field(default=0.0, ge=0)
    sharpness: Rate = 1.0
    batch: Batch = 256
    learning_rate: Rate = 1e-3
    rate_penalty: float = Field(default=0.1, ge=0)
    rate_target: Share = 0.13
    input_penalty: float = Field(default=0.1, ge=0)
    input_target: Share = 0.13
    precision: Literal["float32", "bfloat16"] = "bfloat16"
    log_every: Positive = 100
    checkpoint_every: Positive = 1_000
