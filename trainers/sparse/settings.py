"""Settings of sparse policies: imitation through whole walks, and rounds of pruning."""

from typing import Literal

from pydantic import Field, model_validator

from spikedeploy.trainers.config import (
    EVALUATION_SEEDS,
    Batch,
    Count,
    Positive,
    Rate,
    RunConfig,
    Share,
    ValidationConfig,
)


class SparseConfig(RunConfig):
    """DAgger over whole walks, then pruning by operations in rounds (docs/sparse.md).

    teacher, teacher_units: policy to imitate, as in DistillConfig
    pool: run folder whose walks are taken over as well
    budget: operations of a control step at the end: SOPs of a spiking policy, effective MACs of a
        float one; 0 lets a search find it
    search: whether rounds follow from validation instead of `levels`: at most `dense_rounds`, until
        `patience` of them brought nothing, then levels of `shrink` times the operations before, to
        the budget, or until two in a row do not keep `keep`; a level that does not is trained on
        for at most `polish` rounds
    keep: share of the teacher's return, over that of random actions, in validation
    confirm: further episodes, of the seeds behind those of validation, that decide whether a level
        keeps it: those of validation have chosen its checkpoint
    patience: dense rounds that may pass without a better validation
    shrink: operations of a level over those of the one before
    levels: operations at the end of each round of pruning, falling; those not above `budget` are
        left out, and where none are named they are 3, 2, 1.5 and 1.2 times the budget
    polish: rounds of further training at the budget, each with fresh walks
    teacher_walks, noisy_walks, walks: episodes in the pool from the teacher, from the teacher with
        noise, and from the student after each round
    noise: standard deviation of that noise on continuous actions; of discrete ones the share that
        is drawn at random
    dense_updates, level_updates, polish_updates: gradient updates before pruning, in each level,
        and in each round of polish; `validation.every`, `log_every` count updates
    dense_rounds: number of times that walks are collected before pruning
    window, burn_in: control steps of a window of a walk, and how many of them at its beginning only
        bring the states up
    batch: windows of an update; a float policy takes as many states as all windows have
    first_windows, crash_windows: shares of windows that start with the episode, and that lie in the
        last `crash_steps` before a crash or fall
    learning_rate, level_rate, polish_rate: at the beginning of each phase; falls by a half cosine
    penalty: weight of the hidden neurons' operations over `max(budget, penalty_floor)`
    rate_target, rate_cost: mean firing rate of the hidden layer above which it costs more, and the
        operations that a rate of 1 above it counts for [spikes per neuron and control step]
    step: geometric mean of the encoder's steps [standard deviations]; binary observations have
        a step of their whole swing
    retune: after which rounds steps are set anew, by how much each observation matters: "always",
        "never", or "before-polish", which leaves the encoder as it is in the rounds of polish
    prune_every, prune_until: updates between two prunings, and the share of a level with prunings
    chip: on which policies are validated, and for whose weights they are rounded in training
    rounding: whether the forward pass computes with the chip's rounded weights after pruning began
    sharpness: factor of the teacher's logits in the targets of discrete actions
    """

    teacher: str = ""
    teacher_units: Literal["own", "scaled"] | None = None
    pool: str = ""
    budget: float = Field(default=100.0, ge=0)
    search: bool = False
    keep: Share = 0.98
    confirm: Positive = 30
    patience: Positive = 2
    shrink: float = Field(default=0.7, gt=0, lt=1)
    levels: tuple[Rate, ...] = ()
    polish: Count = 2
    teacher_walks: Count = 60
    noisy_walks: Count = 30
    walks: Positive = 50
    noise: float = Field(default=0.3, ge=0)
    dense_updates: Positive = 3_000
    level_updates: Positive = 3_000
    polish_updates: Positive = 2_000
    dense_rounds: Count = 3
    window: Batch = 20
    burn_in: Count = 6
    batch: Batch = 88
    first_windows: Share = 0.06
    crash_windows: Share = 0.0
    crash_steps: Positive = 60
    learning_rate: Rate = 3e-3
    level_rate: Rate = 1.5e-3
    polish_rate: Rate = 1e-3
    penalty: float = Field(default=0.02, ge=0)
    penalty_floor: Rate = 300.0
    rate_target: Share = 0.07
    rate_cost: float = Field(default=0.0, ge=0)
    step: Rate = 0.5
    retune: Literal["always", "before-polish", "never"] = "always"
    prune_every: Positive = 20
    prune_until: Share = 0.5
    chip: str = "loihi1"
    rounding: bool = True
    sharpness: Rate = 2.0
    log_every: Positive = 200
    checkpoint_every: Positive = 1_000
    validation: ValidationConfig = ValidationConfig(every=1_000, episodes=24)

    @model_validator(mode="after")
    def _windows_are_longer_than_their_burn_in(self) -> "SparseConfig":
        if self.window <= self.burn_in:
            raise ValueError(
                f"window: {self.window} control steps leave none to learn from behind burn_in "
                f"({self.burn_in}). Make window longer or burn_in shorter"
            )
        return self

    @model_validator(mode="after")
    def _there_are_walks(self) -> "SparseConfig":
        if not (self.pool or self.teacher_walks or self.noisy_walks):
            raise ValueError(
                "teacher_walks and noisy_walks: both are 0, so that there is nothing to learn "
                "from. Set one of them, or pool=RUN"
            )
        return self

    @model_validator(mode="after")
    def _a_budget_is_given_or_found(self) -> "SparseConfig":
        if not (self.budget or self.search):
            raise ValueError("budget: 0 operations. Name them, or set search=true to find them")
        if self.search and not self.dense_rounds:
            raise ValueError("dense_rounds: a search needs one at least")
        return self

    @model_validator(mode="after")
    def _confirming_episodes_are_of_validation(self) -> "SparseConfig":
        first = self.validation.first_seed + self.validation.episodes
        if self.search and first + self.confirm > EVALUATION_SEEDS:
            raise ValueError(
                f"confirm: {self.confirm:,} episodes behind those of validation reach the seeds of "
                f"evaluation; at most {EVALUATION_SEEDS - first:,} do not"
            )
        return self

    @property
    def confirming(self) -> list[int]:
        """Seeds of the episodes that confirm a level."""
        first = self.validation.first_seed + self.validation.episodes
        return list(range(first, first + self.confirm))

    @property
    def levels_in_order(self) -> tuple[float, ...]:
        """Operations at the end of each round of pruning: fewer and fewer, the budget last."""
        levels = self.levels or tuple(k * self.budget for k in (3.0, 2.0, 1.5, 1.2))
        return (*sorted((x for x in levels if x > self.budget), reverse=True), self.budget)
