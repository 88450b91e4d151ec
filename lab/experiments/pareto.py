"""The pareto experiment: return against operations and energy, sparse policies and their baselines.

Within a seed the spiking network is trained first; its baselines take over its walks and are
trained with as many updates a level. A baseline is pruned by the same ranking, to levels of its
own. Then each of them goes on with reward from its best policy, with as many episodes.

Each row is a file of its own, <runs>/evaluations/<training>/<level>@<place>.json, which says what
it was made with: a stopped experiment goes on after the last row, and a row whose checkpoint or
sizes have changed is made again.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from lab.experiments import QUICK
from lab.experiments.networks import Played, is_discrete, network, play
from lab.experiments.runner import Design, Part
from lab.experiments.training import Record, StoredRow, TrainingJob, results
from spikedeploy import zoo
from spikedeploy.runtime.errors import ConfigError, RuleError
from spikedeploy.seeds import EVALUATION
from spikedeploy.trainers.run_folder import LEVEL, RunFolder
from spikedeploy.trainers.sparse.pool import Stateless

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
BEST = "best"  # the checkpoint at the budget of a training by imitation
REWARD = "reward"
LEVELS, LAST = "levels", "last level"  # parts: every level, and where else the last one runs
_CHIPS = ("ideal", "loihi2", "xylo-a3")  # beside loihi1, on which all levels are evaluated
_GRADED_CHIP = "loihi2"  # graded spikes run on it and on ideal
_BITS = (6, 5, 4, 3, 2)
_FULL = 8  # [bits] of the weights of every level
_VERSION = 1  # of what a row holds; a higher one makes all rows again
_FORM = {"env": str, "student": str, "place": str, "episodes": int}  # of a row

_TUNED, _BOTH = "tuned.", "env."  # settings of trainings with reward, and of all


@dataclass(frozen=True)
class StudentTraining(TrainingJob):
    """A training of a student: by imitation, or with reward after it.

    student  of STUDENTS
    level    from which it went on with reward: BEST, or an earlier checkpoint; empty by imitation
    """

    student: str = ""
    level: str = ""

    @property
    def trained_by(self) -> str:
        """As its rows say it."""
        return REWARD if self.level else "imitation"

    @property
    def levels(self) -> list[str]:
        """Names of the checkpoints that are evaluated, most operations first."""
        if self.level:
            return [BEST]
        return list(reversed(RunFolder(self.run).levels.values())) if self.run else []

    def aim(self, level: str) -> float:
        """Operations that a checkpoint aims at; with reward those of the policy at the start."""
        if self.level == BEST:
            return float(self.parents["start"].config.budget)
        return operations_of(self.level or level)


def operations_of(level: str) -> float:
    """Operations that a level of pruning aims at, from its checkpoint's name."""
    return float(level.removeprefix(LEVEL))


@dataclass(frozen=True)
class ParetoDesign(Design):
    """The parts of the experiment in one environment.

    env            short name
    settings       those that begin with `tuned.` are of trainings with reward, with `env.` of all
    chip_episodes  of the evaluations of the last level, on other chips and in fewer bits
    levels         how many of the last levels are evaluated with all episodes; None for all
    """

    env: str = ""
    chip_episodes: int = 30
    levels: int | None = None

    NAME = "pareto"
    OPTIONS: ClassVar = Design.OPTIONS | {
        "env": "env", "chip-episodes": "chip_episodes", "levels": "levels"
    }  # fmt: skip
    QUICK: ClassVar = Design.QUICK | {"chip_episodes": 2}
    ENVS: ClassVar = ENVS

    def __post_init__(self) -> None:
        if self.env not in ENVS:
            raise ConfigError(
                f"the pareto experiment has no environment {self.env!r}; known: {', '.join(ENVS)}"
            )
        super().__post_init__()

    @classmethod
    def of(cls, options: Mapping[str, Any]) -> Any:  # noqa: ANN401
        """The design of the options; karts finish or not, which needs more episodes."""
        env, quick = str(options.get("env")), options.get("quick", False)
        usual = {"runs": str(Path("runs") / ("pareto-quick" if quick else "pareto") / env)}
        more = {"episodes": 300} if not quick and env.startswith("kart") else {}
        given = {**usual, **more, **options}
        return super().of(given if "env" in options else options)

    def _overrides(self, tuned: bool) -> tuple[str, ...]:
        """Settings of every training by imitation, or with reward."""
        tune = (f"{_TUNED}{setting}" for setting in QUICK["distill-sparse-tuned"])
        quick = ("env.count=2", *QUICK["distill-sparse"], *tune) if self.quick else ()
        every = (*quick, *self.settings)
        if tuned:
            found = (each for each in every if each.startswith((_TUNED, _BOTH)))
            return tuple(each.removeprefix(_TUNED) for each in found)
        return tuple(each for each in every if not each.startswith(_TUNED))

    def imitations(self) -> list[StudentTraining]:
        """All trainings by imitation, seed by seed, the spiking network of a seed first."""
        found = []
        for seed in range(self.seeds):
            walks: dict[str, TrainingJob] = {}
            for student in STUDENTS:
                recipe = f"{self.env}-{student}"
                found.append(
                    StudentTraining(
                        f"{recipe}-s{seed}", recipe, seed, self.runs, self._overrides(False),
                        walks, student=student,
                    )
                )  # fmt: skip
                walks = walks or {"pool": found[-1]}
        return found

    def tunings(self) -> list[StudentTraining]:
        """All trainings with reward, in the order of those by imitation.

        PPO goes on with LIF neurons and with float networks, so delta networks have none.
        """
        found = []
        for start in (each for each in self.imitations() if each.student not in GRADED):
            earlier = () if self.quick else EARLIER.get((self.env, start.student), ())
            for level in (BEST, *earlier):
                at_level = (f"start_checkpoint={level}",)
                suffix, more = ("", ()) if level == BEST else (f"-{level}", at_level)
                found.append(
                    StudentTraining(
                        f"{self.env}-tuned-{start.student}{suffix}-s{start.seed}",
                        f"{self.env}-sparse-tuned", start.seed, self.runs,
                        (*self._overrides(True), *more), {"start": start}, at_level,
                        student=start.student, level=level,
                    )
                )  # fmt: skip
        return found

    def trainings(self) -> list[StudentTraining]:
        """Trainings of both kinds: within a seed first those by imitation."""
        return sorted([*self.imitations(), *self.tunings()], key=lambda training: training.seed)

    @property
    def references(self) -> dict[str, str]:
        """Policies beside which students stand: the teacher, and the reference if there is one."""
        found = {"teacher": self.imitations()[0].planned().teacher}
        if self.env in REFERENCES and REFERENCES[self.env] != found["teacher"]:
            found["reference"] = REFERENCES[self.env]
        return found

    def places(self, student: str, last: bool) -> list[str]:
        """Where a level is evaluated with all episodes, or the last one with few of them.

        Chips of spiking students; of float ones `int8` and so on, or `float32`.
        """
        if student in FLOAT:
            return ["float32", *(f"int{bits}" for bits in _BITS)] if last else [f"int{_FULL}"]
        at, others = (self.chip, _CHIPS) if student in SPIKING else (_GRADED_CHIP, ("ideal",))
        return [*others, *(f"{at}:weight_bits={bits}" for bits in _BITS)] if last else [at]

    def parts(self) -> list[Part]:
        """Each training, and its levels after it; last levels elsewhere come at the end."""
        parts = [Part(" and ".join(self.references), self.reference_rows)]
        for training in self.trainings():
            parts += [Part.to_train(training), self._evaluation(training, last=False)]
        return [*parts, *(self._evaluation(each, last=True) for each in self.imitations())]

    def _evaluation(self, training: StudentTraining, last: bool) -> Part:
        name = f"{training.name}: {'last level on chips' if last else 'levels'}"
        rows = partial(self.rows, training, last, self.levels)
        return Part(name, rows, of=training, after=[training.name])

    # rows

    def rows(
        self, training: StudentTraining, last: bool, levels: int | None = None
    ) -> list[StoredRow]:
        """The rows of a training: of its last levels, or of the last one with few episodes.

        levels  how many; None for all
        """
        count = 1 if last else levels
        found = training.levels[-count:] if count else training.levels
        places = self.places(training.student, last)
        return [self._row(training, level, place, last) for level in found for place in places]

    def _row(self, training: StudentTraining, level: str, place: str, last: bool) -> StoredRow:
        made = {
            "recipe": training.recipe,
            "seed": training.seed,
            "level": level,
            "place": place,
            "part": LAST if last else LEVELS,
            "checkpoint": zoo.sha256(training.checkpoint(level)),
            **self._sizes(last),
        }
        name = f"{level}@{place}.json".replace(":", "-")
        file = Path(self.runs) / "evaluations" / training.name / name
        return StoredRow(file, made, partial(self._evaluate, training, made), form=_FORM)

    def reference_rows(self) -> list[StoredRow]:
        """The rows of teacher and reference, on the seeds of every level."""
        folder, sizes = Path(self.runs) / "evaluations", self._sizes(False)
        return [
            StoredRow(
                folder / f"{self.env}-{name}.json", {name: policy} | sizes,
                partial(self._evaluate_reference, name, policy), form=_FORM,
            )
            for name, policy in self.references.items()
        ]  # fmt: skip

    def _sizes(self, last: bool) -> Record:
        return {
            "episodes": self.chip_episodes if last else self.episodes,
            "first_seed": EVALUATION,
            "limit": self.limit,
            "version": _VERSION,
        }

    def _evaluate(self, training: StudentTraining, of: Record) -> Record:
        level, place = of["level"], of["place"]
        facts = {
            "env": self.env,
            "student": training.student,
            "seed": training.seed,
            "level": training.aim(level),
            "place": place,
            "part": of["part"],
            "episodes": of["episodes"],
        }
        try:
            file = Path(self.runs) / "policies" / f"{training.name}-{level}"
            made = network(training.existing_run, level, place, file)
        except RuleError as error:
            return facts | {"refusal": str(error)}
        played = play(training.config.env, of["episodes"], made.controller, self.limit)
        counts = made.counts(played.walks)
        if counts.get("on_host") and of["part"] == LEVELS:
            raise ConfigError(
                f"{place} has no way out for membranes: the host would integrate "
                f"{counts['on_host']:g} readouts, which the experiment does not price. Choose a "
                "chip with readouts: loihi1."
            )
        return facts | counts | outcomes(played)

    def _evaluate_reference(self, name: str, policy: str) -> Record:
        """The row of teacher or reference: float policies."""
        from spikedeploy.trainers.distill.teachers import teacher

        env = self.imitations()[0].planned().env.model_copy(update={"count": 1})
        act = teacher(policy, env.name).act_all
        is_choice = is_discrete(env.name, env.options)
        controller = Stateless((lambda seen: act(seen).argmax(-1)) if is_choice else act)
        played = play(env, self.episodes, controller, self.limit)
        facts = {"env": self.env, "student": name, "episodes": self.episodes, "place": policy}
        return facts | outcomes(played)

    def all_rows(self) -> Iterator[Record]:
        """The results so far: those of teacher and reference, then of all trainings."""
        yield from results(self.reference_rows())
        for training in (*self.imitations(), *self.tunings()):
            for last in (False, True):
                for row in results(self.rows(training, last) if training.is_trained else ()):
                    yield row | {"trained_by": training.trained_by}

    def write(self, results: Path) -> list[Path]:
        """Write page, table and picture of the complete parts; return the files."""
        from lab.experiments.pareto_page import write

        return write(self, results)


def outcomes(played: Played) -> Record:
    """Outcomes of episodes: scores are finishes (0 or 1) of karts, returns of walkers.

    Of karts the returns stand beside the scores.
    """
    infos, returns = played.infos, played.returns
    found: Record = {"return_mean": float(np.mean(returns)), "scores": returns}
    if "gates" not in infos[0]:
        return found | {"falls": float(np.mean([info["fall"] for info in infos]))}
    laps = [float(info["lap_time"]) for info in infos if info["finish"]]
    return found | {
        "scores": [float(bool(info["finish"])) for info in infos],
        "returns": returns,
        "lap_time": float(np.mean(laps)) if laps else None,
        "crashes": float(np.mean([bool(info["crash"]) for info in infos])),
    }
