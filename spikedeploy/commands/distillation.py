"""Recipe and settings of the command `distill`, and a summary of its run."""

import json
from pathlib import Path

from spikedeploy.runtime.errors import ConfigError
from spikedeploy.trainers import metrics
from spikedeploy.trainers.run_folder import RunFolder

_CODINGS = {"population": "population", "rate": "regular"}


def student_settings(
    teacher: str | None,
    size: str | None,
    encoder: str | None,
    timesteps: int | None,
    sparse: bool,
    chip: str | None = None,
) -> tuple[str, list[str]]:
    """Return the recipe and the overrides of a student; what is None stays the recipe's.

    size: neurons of the hidden layers, "64,64"
    encoder: "population", "rate" or "delta"
    sparse: whether the student has a budget of operations
    chip: in whose integers it is trained; None in float
    """
    if chip is not None and sparse:
        raise ConfigError("--for and --budget: students in the integers of a chip are not pruned")
    settings = [] if teacher is None else [f"teacher={json.dumps(teacher)}"]
    if size is not None:
        settings.append(f"policy.hidden={_hidden(size, sparse)}")
    if sparse:
        if encoder not in (None, "delta"):
            raise ConfigError(
                f"--encoder {encoder}: a student with --budget sends events by the delta code; "
                "leave one of the two out"
            )
        if timesteps not in (None, 1):
            raise ConfigError(
                f"--timesteps {timesteps}: a student with --budget computes one timestep in a "
                "control step and keeps its states; leave one of the two out"
            )
        return "distill-sparse", settings
    if encoder == "delta":
        raise ConfigError(
            "--encoder delta is of event-driven students: give them a budget of operations, as in "
            "--budget sops=200"
        )
    if encoder is not None:
        settings.append(f"policy.coding={_CODINGS[encoder]}")
    if timesteps is not None:
        settings.append(f"policy.timesteps={timesteps}")
    if chip is not None:
        return "for-chip", [*settings, f"policy.chip={json.dumps(chip)}"]
    return "distill-snn", settings


def _hidden(size: str, sparse: bool) -> str:
    """Return the neurons of hidden layers as a setting."""
    parts = size.split(",")
    if not all(part.strip().isascii() and part.strip().isdigit() for part in parts):
        raise ConfigError(f"--size {size}: neurons of the hidden layers, as in --size 64,64")
    if sparse and len(parts) > 1:
        raise ConfigError(
            f"--size {size}: a student with --budget has one hidden layer, as in --size 32"
        )
    numbers = [int(part) for part in parts]
    return str(numbers[0] if sparse else numbers)


def teacher_options(run: Path) -> list[str]:
    """Return the options with which `compare` shows the teacher of a run, too."""
    settings = RunFolder(run).settings()
    units = settings.get("teacher_units")
    return ["--teacher", settings["teacher"], *(["--teacher-units", units] if units else [])]


def summarise_returns(run: Path) -> str:
    """Return a line on the validation returns of student and teacher; empty where not known.

    Another says that a budget of operations had nothing pruned.
    """
    folder, line = RunFolder(run), ""
    settings = folder.settings()
    if folder.checkpoint("best").is_file():
        teacher = folder.load("last")[0].get("teacher_return")
        student, episodes = (
            folder.load("best")[0]["eval_return"],
            settings["validation"]["episodes"],
        )
        if teacher is not None:
            line = (
                f"validation, {episodes} episodes: teacher {teacher:,.4g}, student {student:,.4g}\n"
            )
    budget = settings.get("budget")
    if budget is None or not folder.metrics.is_file():
        return line
    rows = [row for row in metrics.read(folder.metrics) if "operations" in row]
    first = next((place for place, row in enumerate(rows) if "goal" in row), 0)
    pruned = [row["operations"] for row in rows[max(first - 1, 0) :]]  # and the last before
    if not first or max(pruned) > budget:
        return line
    return (
        f"{line}the budget of {budget:,.4g} operations did not bind: the student had "
        f"{pruned[0]:,.4g} before pruning, so nothing had to be pruned for it\n"
    )
