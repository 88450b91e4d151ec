"""The design of the lineup experiment: what is trained again, how often, and as it was before.

A comparison's rows are of one training each. Here every shipped policy that was distilled from a
float teacher is trained with more seeds, by the recipe and the settings of its card; the seed of
the card is the shipped file itself.
"""

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from lab.experiments.gymnasium.training import TaskTraining
from spikedeploy import zoo
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.trainers.recipes import RECIPES

_NARROW = "-256"  # ending of a PopSAN with half the neurons in each layer, which is not shipped
# trainings of seconds
_QUICK = (
    "env.count=2", "iterations=2", "states=60", "updates=20", "batch=16", "log_every=10",
    "checkpoint_every=20", "validation.every=20", "validation.episodes=1", "validation.limit=40",
)  # fmt: skip


@dataclass(frozen=True)
class Member:
    """A policy with a seed: the shipped one, or one that is trained as it was.

    env       short name of the environment
    policy    name of the shipped policy, or of the narrower one like it
    seed      of the training
    training  None for the shipped file, which is not trained again
    """

    env: str
    policy: str
    seed: int
    training: TaskTraining | None

    @property
    def name(self) -> str:
        """`hexapod-command-mlp-16-s1`."""
        return f"{self.env}-{self.policy}-s{self.seed}"

    @property
    def key(self) -> tuple[str, str, int]:
        """Environment, policy and seed: what tells rows apart."""
        return self.env, self.policy, self.seed

    @property
    def like(self) -> str:
        """`hexapod/popsan`: the shipped policy that this is, or is trained like."""
        return f"{self.env}/{self.policy.removesuffix(_NARROW)}"

    @property
    def shipped(self) -> Path:
        """The file of the shipped policy."""
        file = zoo.path(self.like)
        if file is None:
            raise ConfigError(f"no policy {self.like} is shipped")
        return file


@dataclass(frozen=True)
class LineupDesign:
    """The parts of the experiment.

    tasks     short names of environments
    seeds     trainings of each policy, from seed 0 up, the shipped one among them
    runs      folder of run folders and evaluations
    episodes  of each evaluation
    chip      on which spiking policies are evaluated
    quick     whether trainings take seconds, for a first look and for tests
    """

    tasks: Sequence[str] = ("hexapod", "hexapod-command")
    seeds: int = 5
    runs: str = "runs/lineup"
    episodes: int = 100
    chip: str = "loihi1"
    quick: bool = False

    def __post_init__(self) -> None:
        for env in self.tasks:
            if not _distilled(env):
                raise ConfigError(f"no policy that was distilled is shipped for {env!r}")
        chip(self.chip)  # raises on an unknown name

    def members(self) -> list[Member]:
        """All policies of all tasks: the shipped ones and their teachers, then seed by seed."""
        found = []
        for env in self.tasks:
            cards = _distilled(env)
            teachers = dict.fromkeys(_teacher(card).partition("/")[2] for card in cards.values())
            found += [Member(env, name, 0, None) for name in teachers]
            found += [Member(env, name, card["seed"], None) for name, card in cards.items()]
            found += list(self._others(env, cards))
        return found

    def _others(self, env: str, cards: Mapping[str, Mapping[str, Any]]) -> Iterator[Member]:
        for seed in range(self.seeds):
            for name, card in cards.items():
                if seed != card["seed"]:
                    yield Member(env, name, seed, self._training(env, name, card, seed))
                if (narrow := f"{card['recipe']}{_NARROW}") in RECIPES:
                    own = self._training(env, f"{name}{_NARROW}", {**card, "recipe": narrow}, seed)
                    yield Member(env, own.role, seed, own)

    def _training(self, env: str, name: str, card: Mapping[str, Any], seed: int) -> TaskTraining:
        own = [each for each in card["overrides"] if not each.startswith("teacher=")]
        settings = (*own, f"teacher={json.dumps(_teacher(card))}", *(_QUICK if self.quick else ()))
        return TaskTraining(env, name, card["recipe"], seed, self.runs, settings)

    def arguments(self) -> dict[str, Any]:
        """The fields as arguments of a job."""
        return {**asdict(self), "tasks": list(self.tasks)}


def _distilled(env: str) -> dict[str, dict[str, Any]]:
    """Name -> card of the shipped policies of an environment that imitate a float teacher."""
    cards = {file.stem: zoo.card(f"{env}/{file.stem}") for file in zoo.policies(env)}
    return {
        name: card
        for name, card in cards.items()
        if card and RECIPES[card["recipe"]].algorithm == "distill"
    }


def teachers(env: str) -> str:
    """Which policies imitate which teacher, in a sentence."""
    found: dict[str, list[str]] = {}
    for name, card in _distilled(env).items():
        found.setdefault(_teacher(card).partition("/")[2], []).append(name)
    said = (f"{', '.join(names)} imitate `{teacher}`" for teacher, names in found.items())
    return f"{'; '.join(said)}."


def _teacher(card: Mapping[str, Any]) -> str:
    """`hexapod/sac`, however the settings of the training named it."""
    path = Path(card["config"]["teacher"])
    return f"{path.parent.name}/{path.stem}"


_SMALL = {"seeds": 2, "episodes": 2}


def asked(options: Mapping[str, Any]) -> LineupDesign:
    """The design of the options of a command; ConfigError where one is of other experiments."""
    if other := sorted(options.keys() - {"env", "seeds", "runs", "episodes", "chip", "quick"}):
        raise ConfigError(f"the experiment lineup has no {other[0]}. Leave it out.")
    given = {name: value for name, value in options.items() if name != "env"}
    if "env" in options:
        given["tasks"] = (options["env"],)
    quick = options.get("quick", False)
    runs = str(Path("runs") / ("lineup-quick" if quick else "lineup"))
    return LineupDesign(**{"runs": runs, **(_SMALL if quick else {}), **given})
