"""The design of the pareto experiment: which policies are trained, where they are evaluated.

Within a seed the spiking network is trained first; its baselines take over its walks and are
trained with as many updates a level. A baseline is pruned by the same ranking, to levels of its
own. Then each of them goes on with reward from its best policy, with as many episodes.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from lab.experiments.pareto.training import Training
from lab.experiments.pareto.tuning import BEST, RewardTraining
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.errors import ConfigError

ENVS = ("hexapod", "hexapod-command", "kart-grid", "kart-gazebo", "kart-steer")
SPIKING = ("sparse", "sparse-linear")
GRADED = ("delta-mlp",)
FLOAT = ("small-mlp", "small-linear")
STUDENTS = (*SPIKING, *GRADED, *FLOAT)
LABELS = {
    "sparse": "LIF",
    "sparse-linear": "delta-linear",
    "delta-mlp": "delta network",
    "small-mlp": "float MLP",
    "small-linear": "float linear",
}
# shipped policies beside the teacher, where that is another one
REFERENCES = {"hexapod-command": "hexapod-command/sac"}
# earlier levels of pruning from which float baselines go on with reward too: where they are strong
EARLIER = {
    ("hexapod", "small-mlp"): ("ops-130",),
    ("hexapod-command", "small-mlp"): ("ops-300",),
}
_CHIPS = ("ideal", "loihi2", "xylo-a3")  # beside loihi1, on which all levels are evaluated
_GRADED_CHIP = "loihi2"  # graded spikes run on it and on ideal
_BITS = (6, 5, 4, 3, 2)
LEVELS, LAST = "levels", "last level"  # parts: every level, and where else the last one runs
_FULL = 8  # [bits] of the weights of every level

# trainings of seconds
QUICK = (
    "env.count=2", "budget=60", "levels=[200]", "teacher_walks=2", "noisy_walks=1", "walks=1",
    "dense_updates=20", "dense_rounds=1", "level_updates=20", "polish=1", "polish_updates=10",
    "prune_every=5", "batch=8", "log_every=5", "checkpoint_every=20", "validation.every=10",
    "validation.episodes=1", "validation.limit=40", "tuned.iterations=2", "tuned.warm_up=1",
    "tuned.episodes=2", "tuned.window=16", "tuned.burn_in=4", "tuned.batch=4", "tuned.epochs=1",
    "tuned.critic_hidden=[16]", "tuned.critic_epochs=1", "tuned.checkpoint_every=1",
    "tuned.validation.every=1", "tuned.validation.episodes=1", "tuned.validation.limit=40",
)  # fmt: skip
_TUNED, _BOTH = "tuned.", "env."  # settings of trainings with reward, and of all


@dataclass(frozen=True)
class ParetoDesign:
    """The parts of the experiment in one environment.

    env            short name
    seeds          trainings of each student, from seed 0 up
    runs           folder of the run folders, of exported policies and of evaluations
    settings       of every training by imitation, as `--set` takes them; those that begin with
                   `tuned.` are of every training with reward, those with `env.` of both
    episodes       of the evaluations of every level
    chip_episodes  of the evaluations of the last level, on other chips and in fewer bits
    chip           on which spiking policies of every level are evaluated
    limit          control steps that an episode of an evaluation may take; None for all
    levels         how many of the last levels are evaluated with all episodes; None for all
    quick          whether trainings take seconds, for a first look and for tests
    """

    env: str
    seeds: int = 3
    runs: str = ""
    settings: Sequence[str] = ()
    episodes: int = 100
    chip_episodes: int = 30
    chip: str = "loihi1"
    limit: int | None = None
    quick: bool = False
    levels: int | None = None

    def __post_init__(self) -> None:
        if self.env not in ENVS:
            raise ConfigError(
                f"the pareto experiment has no environment {self.env!r}; known: {', '.join(ENVS)}"
            )
        chip(self.chip)  # raises on an unknown name

    @property
    def _all_settings(self) -> tuple[str, ...]:
        """Settings of both kinds of trainings, those of small sizes included."""
        return (*(QUICK if self.quick else ()), *self.settings)

    @property
    def overrides(self) -> tuple[str, ...]:
        """Settings of every training by imitation."""
        return tuple(each for each in self._all_settings if not each.startswith(_TUNED))

    @property
    def tuned_overrides(self) -> tuple[str, ...]:
        """Settings of every training with reward."""
        kinds = (_TUNED, _BOTH)
        found = (each for each in self._all_settings if each.startswith(kinds))
        return tuple(each.removeprefix(_TUNED) for each in found)

    def trainings(self) -> list[Training]:
        """All trainings by imitation, seed by seed, the spiking network of a seed first."""
        return [self._training(s, seed) for seed in range(self.seeds) for s in STUDENTS]

    def tunings(self) -> list[RewardTraining]:
        """All trainings with reward, in the order of those by imitation.

        PPO goes on with LIF neurons and with float networks, so delta networks have none.
        """
        recipe, settings = f"{self.env}-sparse-tuned", self.tuned_overrides
        students = [f"{self.env}-{student}" for student in (*SPIKING, *FLOAT)]
        trainings = [each for each in self.trainings() if each.recipe in students]
        return [
            RewardTraining(recipe, training, settings, level)
            for training in trainings
            for level in (BEST, *self._earlier(training.recipe))
        ]

    def _earlier(self, recipe: str) -> Sequence[str]:
        return () if self.quick else EARLIER.get((self.env, student_of(recipe, self.env)), ())

    def everything(self) -> list[Training | RewardTraining]:
        """Trainings of both kinds: within a seed first those by imitation."""
        both: list[Training | RewardTraining] = [*self.trainings(), *self.tunings()]
        return sorted(both, key=lambda training: training.seed)

    @property
    def references(self) -> dict[str, str]:
        """Policies beside which students stand: the teacher, and the reference if there is one."""
        found = {"teacher": self.trainings()[0].planned([]).teacher}
        if self.env in REFERENCES and REFERENCES[self.env] != found["teacher"]:
            found["reference"] = REFERENCES[self.env]
        return found

    def _training(self, student: str, seed: int) -> Training:
        walks = "" if student == STUDENTS[0] else f"{self.env}-{STUDENTS[0]}"
        recipe = f"{self.env}-{student}"
        return Training(recipe, seed, self.runs, self.overrides, walks)

    def places(self, student: str, last: bool) -> list[str]:
        """Where a level is evaluated with all episodes, or the last one with few of them.

        Chips of spiking students; of float ones `int8` and so on, or `float32`.
        """
        if student in SPIKING:
            fewer = [*_CHIPS, *(f"{self.chip}:weight_bits={bits}" for bits in _BITS)]
            return fewer if last else [self.chip]
        if student in GRADED:
            fewer = ["ideal", *(f"{_GRADED_CHIP}:weight_bits={bits}" for bits in _BITS)]
            return fewer if last else [_GRADED_CHIP]
        fewer = ["float32", *(f"int{bits}" for bits in _BITS)]
        return fewer if last else [f"int{_FULL}"]

    def arguments(self) -> dict[str, Any]:
        """The fields as arguments of a job."""
        return {**asdict(self), "settings": list(self.settings)}


_OPTIONS = {
    "env": "env",
    "seeds": "seeds",
    "runs": "runs",
    "set": "settings",
    "episodes": "episodes",
    "chip-episodes": "chip_episodes",
    "chip": "chip",
    "levels": "levels",
    "quick": "quick",
}
_SMALL = {"seeds": 1, "episodes": 2, "chip_episodes": 2, "limit": 40}
_STARTS = {"episodes": 300}  # karts finish or not, which says less than a return


def asked(options: Mapping[str, Any]) -> ParetoDesign:
    """The design of the options of a command; ConfigError where one is of other experiments."""
    if other := sorted(options.keys() - _OPTIONS):
        raise ConfigError(f"the experiment pareto has no {other[0]}. Leave it out.")
    if "env" not in options:
        raise ConfigError(f"the experiment pareto needs an environment: {', '.join(ENVS)}")
    env, quick = options["env"], options.get("quick", False)
    runs = Path("runs") / ("pareto-quick" if quick else "pareto") / env
    sizes = _SMALL if quick else _STARTS if env.startswith("kart") else {}
    given = {_OPTIONS[name]: value for name, value in options.items()}
    return ParetoDesign(**{"runs": str(runs), **sizes, **given})


def student_of(recipe: str, env: str) -> str:
    """The student that a recipe of the environment trains."""
    return recipe.removeprefix(f"{env}-")
