"""The scores of a training run: what its best checkpoint earned, and how far it came."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from spikedeploy.files import is_locked
from spikedeploy.policies import run_record
from spikedeploy.reports.curves import counted_by
from spikedeploy.trainers.metrics import read, spike_rate


@dataclass(frozen=True)
class RunScores:
    """What is known of a run without playing it.

    path        of its folder
    recipe      its name
    env         id of its environment
    seed        of the training
    kind        of its policy, such as "popsan"
    earned      mean return of the best validation
    success     part of the validation's episodes that finish, where the environment says so
    operations  of a control step in the validation, where training counts them
    rate        spikes for each neuron and timestep, mean of the layers, of a network that has them
    steps       of the training so far, and their unit
    share       of the training that is done, from 0 to 1
    running     whether a process trains in it
    changed     [s] since 1970, when it was last written
    """

    path: Path
    recipe: str
    env: str
    seed: int
    kind: str
    earned: float | None
    success: float | None
    operations: float | None
    rate: float | None
    steps: tuple[int, str]
    share: float
    running: bool
    changed: float

    @property
    def name(self) -> str:
        """Of the folder."""
        return self.path.resolve().name

    @property
    def spikes(self) -> bool:
        """Whether the policy does, so that chips run it."""
        return self.kind in run_record.SPIKING

    @property
    def counts(self) -> str:
        """What its operations are: SOPs, or MACs."""
        return "SOPs" if self.spikes else "MACs"

    def as_json(self) -> dict[str, Any]:
        """Plain data."""
        return {**vars(self), "path": str(self.path), "name": self.name, "steps": self.steps[0]}


def scores(run: Path) -> RunScores:
    """The scores of a run folder; of one without a checkpoint those of its metrics."""
    settings, rows = run_record.settings(run), metrics_of(run)
    best = _best(run, rows)
    last = run_record.checkpoint_record(run, "last")
    with run_record.whole(run / "config.json"):
        recipe, seed, kind = settings["recipe"], int(settings["seed"]), settings["policy"]["kind"]
    with run_record.whole(run / "checkpoints"):
        share = float(last.get("share", 1.0 if last else 0.0))
        earned, success, operations = (
            None if best.get(name) is None else float(best[name])
            for name in ("eval_return", "eval_finish", "eval_operations")
        )
        rate = spike_rate(best)
    return RunScores(
        path=run,
        recipe=str(recipe),
        env=run_record.env_of(run) or "",
        seed=seed,
        kind=str(kind),
        earned=earned,
        success=success,
        operations=operations,
        rate=rate,
        steps=_steps(rows),
        share=share,
        running=is_locked(run / ".lock"),
        changed=max(path.stat().st_mtime for path in (run / "config.json", *_written(run))),
    )


def metrics_of(run: Path) -> list[dict[str, float]]:
    """The rows of the metrics of a run; none where it has not begun."""
    metrics = run / "metrics.csv"
    return read(metrics) if metrics.is_file() else []


def _best(run: Path, rows: Sequence[Mapping[str, float]]) -> Mapping[str, Any]:
    """The validation of the checkpoint that is deployed; without one the best of the metrics."""
    record = run_record.checkpoint_record(run, run_record.deployed(run))
    if record.get("eval_return") is not None:
        return record
    validated = [row for row in rows if "eval_return" in row]
    return max(validated, key=lambda row: row["eval_return"], default={})


def _steps(rows: Sequence[Mapping[str, float]]) -> tuple[int, str]:
    """How many steps are in the metrics, and what they are."""
    if not rows:
        return 0, "steps"
    unit = next(iter(rows[-1]))
    return int(rows[-1][unit]), counted_by(unit)


def _written(run: Path) -> list[Path]:
    return [
        path for path in (run / "metrics.csv", *run.glob("checkpoints/*.json")) if path.exists()
    ]
