"""The question of a study: which recipe, what is searched, and what is best."""

import re
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any, Literal, get_args

from spikedeploy.runtime.errors import ConfigError
from spikedeploy.trainers.config import RunConfig, known, resolve
from spikedeploy.trainers.recipes import RECIPES
from spikedeploy.tuning.search import Search
from spikedeploy.tuning.spaces import space

Objective = Literal["return", "return-at-sops", "return,sops"]


@dataclass(frozen=True)
class TuningPlan:
    """What is asked; two studies with the same plan are one.

    recipe     of trainers.recipes
    env        of a recipe for any environment; "" else
    objective  what is best: the return; the return among those within a budget; return and SOPs
    sops       budget [SOPs a control step]; 0 without
    search     texts of --search; none takes the default of the recipe
    fixed      texts of --set
    seed       of all trainings
    episodes   of each evaluation
    chip       on which a spiking policy is evaluated; "float" for its float twin
    """

    recipe: str
    env: str = ""
    objective: Objective = "return"
    sops: float = 0.0
    search: Sequence[str] = ()
    fixed: Sequence[str] = ()
    seed: int = 0
    episodes: int = 20
    chip: str = "loihi1"

    def __post_init__(self) -> None:
        entry = RECIPES[known(self.recipe, RECIPES, "recipe")]
        if entry.any_env != bool(self.env):
            raise ConfigError(
                f"{self.recipe} trains in any environment: name one with --env, as CartPole-v1"
                if entry.any_env
                else f"{self.recipe} has an environment of its own: leave --env out"
            )
        if self.objective not in get_args(Objective):
            choices = ", ".join(get_args(Objective))
            raise ConfigError(f"--objective {self.objective} is unknown; known: {choices}")
        if (self.objective == "return-at-sops") != (self.sops > 0):
            raise ConfigError(
                "--objective return-at-sops takes --sops N, the most SOPs of a control step; the "
                "other objectives take none"
            )
        if self.counts and not self.config.policy.spiking_layers and not self._events:
            raise ConfigError(
                f"{self.recipe} trains a float policy, which has no SOPs: --objective return"
            )

    @property
    def counts(self) -> bool:
        """Whether synaptic operations matter."""
        return self.objective != "return"

    @property
    def two(self) -> bool:
        """Whether there are two objectives."""
        return self.objective == "return,sops"

    @property
    def _events(self) -> bool:
        """Whether a policy without hidden neurons sends events into a readout."""
        return self.config.policy.kind in ("delta-snn", "delta-mlp")

    @property
    def name(self) -> str:
        """`ppo-snn CartPole-v1 return`, of the study."""
        return " ".join(filter(None, (self.recipe, self.env, self.objective)))

    @property
    def title(self) -> str:
        """The environment in letters that a path may have."""
        return re.sub(r"[^A-Za-z0-9.-]+", "-", self.env)

    @cached_property
    def config(self) -> RunConfig:
        """The recipe with the fixed settings."""
        from spikedeploy.trainers.train import algorithm

        kind = algorithm(RECIPES[self.recipe].algorithm)
        config: RunConfig = resolve(kind.Config, self.recipe, overrides=self.fixed, seed=self.seed)
        return config

    @cached_property
    def space(self) -> dict[str, Search]:
        """Setting -> what it may be."""
        return space(self.config, self.search, self.fixed)

    def overrides(self, values: Mapping[str, Any]) -> list[str]:
        """Settings of a trial as `--set` takes them, those that are fixed first."""
        return [*self.fixed, *(f"{key}={value}" for key, value in values.items())]

    def command(self, values: Mapping[str, Any]) -> str:
        """The command line that trains with these settings."""
        what = [self.env, "--recipe", self.recipe] if self.env else [self.recipe]
        words = ["spikedeploy", "train", *what]
        for text in self.overrides(values):
            words += ["--set", text]
        if self.seed:
            words += ["--seed", str(self.seed)]
        return shlex.join(words)

    def as_json(self) -> dict[str, Any]:
        """The fields as plain data."""
        return {**asdict(self), "search": list(self.search), "fixed": list(self.fixed)}
