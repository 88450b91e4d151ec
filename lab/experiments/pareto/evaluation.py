"""Evaluations of one training, or of the references, on seeds that no training or choice has seen.

Each row is a file of its own, <runs>/evaluations/<training>/<level>@<place>.json, which says what
it was made with: a stopped experiment goes on after the last row, and a row whose checkpoint or
sizes have changed is made again.
"""

import hashlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from lab.experiments.pareto.design import LAST, LEVELS, ParetoDesign, student_of
from lab.experiments.pareto.networks import greedy, network, outcomes
from lab.experiments.pareto.training import Training
from lab.experiments.pareto.tuning import RewardTraining
from lab.experiments.stored_row import StoredRow
from spikedeploy.runtime.errors import ConfigError, RuleError
from spikedeploy.seeds import EVALUATION
from spikedeploy.trainers.config import EnvConfig
from spikedeploy.trainers.sparse.pool import BatchController, Episodes

Record = dict[str, Any]
_VERSION = 1  # of what a row holds; a higher one makes all rows again


def rows(
    design: ParetoDesign, training: Training | RewardTraining, last: bool, levels: int | None = None
) -> list[StoredRow]:
    """The rows of a training: of its last levels, or of the last one with few episodes.

    levels  how many; None for all
    """
    count = 1 if last else levels
    found = training.levels[-count:] if count else training.levels
    places = design.places(student_of(training.student, design.env), last)
    return [_row(design, training, level, place, last) for level in found for place in places]


def _row(
    design: ParetoDesign, training: Training | RewardTraining, level: str, place: str, last: bool
) -> StoredRow:
    if training.run is None:
        raise ConfigError(f"{training.name} has no run folder")
    checkpoint = (training.run / "checkpoints" / f"{level}.safetensors").read_bytes()
    made = {
        "recipe": training.recipe,
        "seed": training.seed,
        "level": level,
        "place": place,
        "part": LAST if last else LEVELS,
        "checkpoint": hashlib.sha256(checkpoint).hexdigest(),
    }
    path = Path(design.runs) / "evaluations" / training.name / f"{level}@{place}.json"
    return StoredRow(path.with_name(path.name.replace(":", "-")), made | _sizes(design, last))


def reference_rows(design: ParetoDesign) -> list[StoredRow]:
    """The rows of teacher and reference, on the seeds of every level."""
    folder, sizes = Path(design.runs) / "evaluations", _sizes(design, False)
    return [
        StoredRow(folder / f"{design.env}-{name}.json", {name: policy} | sizes)
        for name, policy in design.references.items()
    ]


def _sizes(design: ParetoDesign, last: bool) -> Record:
    return {
        "episodes": design.chip_episodes if last else design.episodes,
        "first_seed": EVALUATION,
        "limit": design.limit,
        "version": _VERSION,
    }


def perform(design: Record, name: str, last: bool) -> bool:
    """Make the missing rows of a training (a job of `resumable`)."""
    asked = ParetoDesign(**design)
    training = next(each for each in asked.everything() if each.name == name)
    if not training.trained or training.run is None:
        raise ConfigError(f"{training.name} is not trained yet, so there is nothing to evaluate")
    for row in rows(asked, training, last, asked.levels):
        if row.found is None:
            row.write(_evaluated(asked, training, row))
    return True


def _evaluated(design: ParetoDesign, training: Training | RewardTraining, row: StoredRow) -> Record:
    level, place = row.of["level"], row.of["place"]
    if training.run is None:
        raise ConfigError(f"{training.name} has no run folder")
    facts = {
        "env": design.env,
        "student": student_of(training.student, design.env),
        "seed": training.seed,
        "level": training.operations_of(level),
        "place": place,
        "part": row.of["part"],
        "episodes": row.of["episodes"],
    }
    try:
        file = Path(design.runs) / "policies" / f"{training.name}-{level}"
        made = network(training.run, level, place, file)
    except RuleError as error:
        return facts | {"refusal": str(error)}
    walks, found = _played(
        training.config(training.run).env, design, row.of["episodes"], made.controller
    )
    done = made.done(walks)
    if done.get("on_host") and row.of["part"] == LEVELS:
        raise ConfigError(
            f"{place} has no way out for membranes: the host would integrate {done['on_host']:g} "
            "readouts, which the experiment does not price. Choose a chip with readouts: loihi1."
        )
    return facts | done | found


def perform_references(design: Record) -> bool:
    """Make the missing rows of teacher and reference (a job of `resumable`)."""
    asked = ParetoDesign(**design)
    for (name, policy), row in zip(asked.references.items(), reference_rows(asked), strict=True):
        if row.found is None:
            facts = {"env": asked.env, "student": name, "episodes": asked.episodes}
            row.write(facts | {"place": policy} | _walked(asked, policy))
    return True


def _walked(design: ParetoDesign, policy: str) -> Record:
    """What a float policy earns on the seeds of every level."""
    from spikedeploy.trainers.distill.teachers import teacher

    env = design.trainings()[0].planned([]).env.model_copy(update={"count": 1})
    controller = greedy(teacher(policy, env.name).act_all, _discrete(env))
    return _played(env, design, design.episodes, controller)[1]


def _discrete(config: EnvConfig) -> bool:
    import gymnasium

    from spikedeploy import envs

    env = envs.make(config.name, **config.options)
    found = isinstance(env.action_space, gymnasium.spaces.Discrete)
    env.close()
    return found


def _played(
    config: EnvConfig, design: ParetoDesign, episodes: int, controller: BatchController
) -> tuple[list[Any], Record]:
    """Walks, and what they came to; all in one batch."""
    seeds = range(EVALUATION, EVALUATION + episodes)
    together = Episodes(config, episodes, design.limit)
    # walks are kept only with labels, of which nothing is needed here
    walks, returns, infos = together.play(seeds, controller, lambda seen: seen[:, :0])
    return walks, outcomes(returns, infos)


def all_rows(design: ParetoDesign) -> Iterator[Record]:
    """The results so far: those of teacher and reference, then of all trainings."""
    for reference in reference_rows(design):
        found = reference.found
        if found is not None:
            yield found
    trainings: list[Training | RewardTraining] = [*design.trainings(), *design.tunings()]
    for training in trainings:
        for last in (False, True):
            for row in rows(design, training, last) if training.trained else ():
                found = row.found
                if found is not None:
                    yield found | {"trained_by": training.trained_by}
