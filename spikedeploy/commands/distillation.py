"""Recipe and settings of the command `distill`, its float rival, and what came of both."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from spikedeploy.runtime.errors import ConfigError
from spikedeploy.trainers.run_folder import RunFolder, runs_in

_CODINGS = {"population": "population", "rate": "regular"}
SPARSE, RIVAL = "distill-sparse", "distill-small-mlp"  # recipes
_ENOUGH = 0.90  # of the teacher; below it a student is said to have learned too little
_UNITS = {"delta-snn": "SOPs", "pruned-mlp": "MACs"}
FRONT = "front.png"  # in the run folder of the student


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
    sparse: whether the student sends events and is pruned
    chip: in whose integers it is trained; None in float
    """
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
        return SPARSE, settings
    if encoder == "delta":
        raise ConfigError("--encoder delta is of sparse students: leave --dense and --for out")
    if encoder is not None:
        settings.append(f"policy.coding={_CODINGS[encoder]}")
    if timesteps is not None:
        settings.append(f"policy.timesteps={timesteps}")
    if chip is not None:
        return "for-chip", [*settings, f"policy.chip={json.dumps(chip)}"]
    return "distill-snn", settings


def is_sparse(
    dense: bool, chip: str | None, encoder: str | None, timesteps: int | None, budget: str | None
) -> bool:
    """Return whether a student sends events and is pruned: unless options say otherwise."""
    if budget is not None:
        if dense or chip is not None:
            other = "--dense" if dense else "--for"
            raise ConfigError(f"{other} and --budget: such students are not pruned")
        return True
    return not dense and chip is None and encoder in (None, "delta") and timesteps in (None, 1)


def _hidden(size: str, sparse: bool) -> str:
    """Return the neurons of hidden layers as a setting."""
    parts = size.split(",")
    if not all(part.strip().isascii() and part.strip().isdigit() for part in parts):
        raise ConfigError(f"--size {size}: neurons of the hidden layers, as in --size 64,64")
    if sparse and len(parts) > 1:
        raise ConfigError(
            f"--size {size}: a sparse student has one hidden layer, as in --size 32; --dense has "
            "several"
        )
    numbers = [int(part) for part in parts]
    return str(numbers[0] if sparse else numbers)


def has_rival(run: Path) -> bool:
    """Return whether a small float MLP is to be trained beside a run."""
    settings = RunFolder(run).settings()
    return bool(settings["recipe"] == SPARSE and settings["search"])


def rival_arguments(run: Path, given: Sequence[str]) -> dict[str, Any]:
    """Return the arguments of `train` for the rival of a student: a new one, or to be resumed.

    given: overrides of the student, of which those of its network are not the rival's

    It begins with all walks of the student, and has the same rounds, levels and budget. Its run is
    in the student's, which stays the last one.
    """
    settings, runs = RunFolder(run).settings(), run / "rival"
    if found := runs_in(runs):
        return {"recipe": None, "resume": found[0], "runs": runs}
    kept = [text for text in given if not text.replace(" ", "").startswith(("policy.", "pool="))]
    same = ("teacher", "teacher_units", "budget")
    overrides = [f"{name}={json.dumps(settings[name])}" for name in same if settings[name]]
    options = settings["env"]["options"]
    overrides += [f"env.options.{name}={json.dumps(value)}" for name, value in options.items()]
    overrides += [f"pool={json.dumps(str(run))}", "teacher_walks=0", "noisy_walks=0"]
    return {
        "recipe": RIVAL, "env": settings["env"]["name"], "seed": settings["seed"], "runs": runs,
        "overrides": [*kept, *overrides],
    }  # fmt: skip


def teacher_options(run: Path) -> list[str]:
    """Return the options with which `compare` shows the teacher of a run, too."""
    settings = RunFolder(run).settings()
    units = settings.get("teacher_units")
    return ["--teacher", settings["teacher"], *(["--teacher-units", units] if units else [])]


# -- what came of it


@dataclass(frozen=True)
class Level:
    """A level of pruning: its best checkpoint, in validation.

    operations: of a control step, as validation counted them
    share: of the teacher's return, over that of random actions
    chosen: whether it is the policy of the run
    """

    operations: float
    share: float
    chosen: bool


def front(run: Path) -> list[Level]:
    """Return the levels of a run that was pruned, the most operations first."""
    folder = RunFolder(run)
    best = folder.load("best")[0] if folder.checkpoint("best").is_file() else {}
    found = []
    for level in folder.levels.values():
        state = folder.load(level)[0]
        chosen = bool(best) and state["updates"] == best["updates"]
        found.append(Level(state["eval_operations"], state["eval_of_teacher"], chosen))
    if best and not any(each.chosen for each in found):  # what was never pruned
        found.append(Level(best["eval_operations"], best["eval_of_teacher"], True))
    return sorted(found, key=lambda each: -each.operations)


def fronts(run: Path, rival: Path | None) -> Mapping[str, list[Level]]:
    """Return the levels of a student, and of its rival, by what they are called."""
    named = {"spiking student": run, **({"float MLP": rival} if rival else {})}
    return {name: front(path) for name, path in named.items()}


def draw_front(run: Path, rival: Path | None) -> Path:
    """Draw operations against the share of the teacher's return; return the PNG."""
    from spikedeploy.reports.plots import BLUE, LEGEND_ABOVE, VERMILION, framed_figure, save

    figure, axes = framed_figure(3.6)
    for (name, levels), colour in zip(fronts(run, rival).items(), (VERMILION, BLUE), strict=False):
        shares = [100 * each.share for each in levels]
        axes.plot([e.operations for e in levels], shares, "o-", color=colour, ms=4, label=name)
        for each in filter(lambda e: e.chosen, levels):
            axes.plot(each.operations, 100 * each.share, "o", ms=11, mfc="none", mec=colour)
    config = RunFolder(run).settings()
    axes.axhline(100 * config["keep"], color="0.6", lw=1, ls=":")
    axes.set_xscale("log")
    axes.set_xlabel("operations of a control step: SOPs of the student, MACs of the float MLP")
    axes.set_ylabel("of the teacher, validation [%]")
    low = min(100 * each.share for of in fronts(run, rival).values() for each in of)
    axes.set_ylim(max(low - 3, -5), None)
    axes.legend(**LEGEND_ABOVE, ncols=2)
    return save(figure, run / FRONT)


def describe(run: Path, rival: Path | None) -> str:
    """Return lines on what student and rival keep of the teacher, in validation, and at what cost.

    One says so where the student has learned too little, or a budget had nothing pruned.
    """
    folder = RunFolder(run)
    settings = folder.settings()
    if not folder.checkpoint("best").is_file():
        return ""
    last, best = folder.load("last")[0], folder.load("best")[0]
    teacher, student = last.get("teacher_return"), best["eval_return"]
    episodes = settings["validation"]["episodes"]
    text = f"validation, {episodes} episodes: teacher {teacher:,.4g}, student {student:,.4g}\n"
    if not settings.get("search"):
        return text
    text = f"{text[:-1]}, random actions {last['random_return']:,.4g}\n"
    chosen = {name: [e for e in of if e.chosen] for name, of in fronts(run, rival).items()}
    for (name, levels), unit in zip(chosen.items(), ("SOPs", "MACs"), strict=False):
        for each in levels:
            text += f"{name}: {each.share:.1%} of the teacher with {each.operations:,.0f} {unit}\n"
    share = best["eval_of_teacher"]
    if share < _ENOUGH:
        c = settings
        text += (
            f"it keeps only {share:.1%}: let it walk and learn for longer, or send finer events: "
            f"--set walks={2 * c['walks']} --set dense_updates={2 * c['dense_updates']}, or "
            f"--set step={c['step'] / 2:g} --set policy.most={2 * c['policy']['most']}\n"
        )
    if settings["budget"] and (before := _before_pruning(folder)) <= settings["budget"]:
        text += (
            f"the budget of {settings['budget']:,.4g} operations did not bind: the student had "
            f"{before:,.4g} before pruning\n"
        )
    return text


def _before_pruning(run: RunFolder) -> float:
    """Return the operations of a control step of the student that was not pruned yet."""
    ended = run.load("last")[0]["ended"]
    return float(next(each["operations"] for each in reversed(ended) if each["goal"] is None))


def print_front(run: Path, rival: Path | None) -> None:
    """Print the levels of student and rival, side by side a table each."""
    from spikedeploy.reports.table import Table

    for name, levels in fronts(run, rival).items():
        unit = _UNITS["delta-snn" if name == "spiking student" else "pruned-mlp"]
        rows = [
            (f"{e.operations:,.0f}", f"{e.share:.1%}", "this" if e.chosen else "") for e in levels
        ]
        Table((unit, "of teacher", "kept"), rows, f"{name}, validation").print()
