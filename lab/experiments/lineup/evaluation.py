"""Rows of the lineup experiment, on seeds that no training and no choice of a policy has seen.

Each row is a file of its own, <runs>/evaluations/<member>.json, which says what it was made with.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any, TypeGuard

from lab.experiments.evaluation import evaluate
from lab.experiments.lineup.design import LineupDesign, Member
from lab.experiments.pareto.training import complete
from lab.experiments.stored_row import StoredRow
from spikedeploy import zoo
from spikedeploy.files import read_json
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.shipping.exported_run import runnable
from spikedeploy.trainers.versions import in_words

Record = dict[str, Any]
_COUNTS = ("sops_per_inference", "macs_dense", "macs_effective")
_FIELDS = (
    "chip", "episodes", "return_mean", "success_rate", "falls", "cot", "speed_rmse",
    "turn_rmse", "sops_per_inference", "macs_dense", "macs_effective",
)  # fmt: skip


def _stored(design: LineupDesign, member: Member) -> StoredRow:
    """The row of a policy that is there."""
    if member.training is None:
        policy = zoo.sha256(member.shipped)
    elif member.training.run is None:
        raise ConfigError(f"{member.name} has no run folder")
    else:
        policy = zoo.sha256(member.training.run / "checkpoints" / "best.safetensors")
    made = {"policy": policy, "episodes": design.episodes, "chip": design.chip}
    return StoredRow(Path(design.runs) / "evaluations" / f"{member.name}.json", made)


def result(design: LineupDesign, member: Member) -> Record | None:
    """The result; None where the policy is not trained yet, or not evaluated."""
    if member.training is not None and not member.training.trained:
        return None
    stored = _stored(design, member)
    row = stored.found
    if row is not None and not (has_fields(row) and key(row) == member.key):
        raise ConfigError(f"{stored.file} is damaged: put it back, or move it away")
    return row


def has_fields(row: Record) -> bool:
    """Whether a row has what the page is made of."""
    returns, successes, count = row.get("returns"), row.get("successes"), row.get("episodes")
    return (
        all(isinstance(row.get(name), str) for name in ("env", "policy", "kind"))
        and isinstance(row.get("seed"), int)
        and isinstance(row.get("return_mean"), int | float)
        and all(isinstance(row.get(name, 0.0) or 0.0, int | float) for name in _COUNTS)
        and all(_numbers(each) and len(each) == count for each in (returns, successes))
    )


def key(row: Record) -> tuple[str, str, int]:
    """Environment, policy and seed: what tells rows apart."""
    return row["env"], row["policy"], row["seed"]


def _numbers(values: object) -> TypeGuard[list[float]]:
    return isinstance(values, list) and all(isinstance(each, int | float) for each in values)


def all_rows(design: LineupDesign) -> Iterator[Record]:
    """The results so far."""
    for member in design.members():
        if (row := result(design, member)) is not None:
            yield row | {"versions": _versions(member)}


def _versions(member: Member) -> str:
    """Versions when the training began."""
    if member.training is None or member.training.run is None:
        return in_words(zoo.card(member.like)["versions"])
    return in_words(read_json(member.training.run / "versions.json"))


def perform(design: Record, name: str) -> bool:
    """Train if need be, and evaluate (a job of `resumable`); False if it was interrupted."""
    asked = LineupDesign(**design)
    member = next(each for each in asked.members() if each.name == name)
    if member.training is not None and not complete(member.training):
        return False
    if result(asked, member) is None:
        _stored(asked, member).write(_evaluated(asked, member))
    return True


def _evaluated(design: LineupDesign, member: Member) -> Record:
    *_, row = evaluate(member.env, {}, _file(member), design.episodes, design.chip)
    about = {"env": member.env, "policy": member.policy, "seed": member.seed}
    about |= {"shipped": member.training is None, "kind": zoo.card(member.like)["kind"]}
    numbers = {name: row[name] for name in _FIELDS if row.get(name) is not None}
    successes = [int(each) for each in row["successes"]]
    return about | numbers | {"returns": row["returns"], "successes": successes}


def _file(member: Member) -> str:
    """The policy's file: the shipped one, or what is exported from the run."""
    if member.training is None:
        return str(member.shipped)
    if member.training.run is None:
        raise ConfigError(f"{member.name} has no run folder")
    return runnable(str(member.training.run))
