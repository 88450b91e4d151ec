"""The float rival of the command `distill`, and what came of both."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from spikedeploy.trainers.config import differences
from spikedeploy.trainers.run_folder import LEVEL, RunFolder, runs_in
from spikedeploy.trainers.sparse.settings import SparseConfig
from spikedeploy.training_settings import SPARSE

RIVAL = "distill-small-mlp"  # recipe
_ENOUGH = 0.90  # of the teacher; below it a student is said to have learned too little
STUDENT, FLOAT = "spiking student", "float MLP"
_UNITS = {STUDENT: "SOPs", FLOAT: "MACs"}


def is_searched(run: Path) -> bool:
    """Return whether a run is of a sparse student that was pruned as far as validation allowed."""
    settings = RunFolder(run).settings()
    return bool(settings["recipe"] == SPARSE and settings.get("search"))


def rival_arguments(run: Path) -> dict[str, Any]:
    """Return the arguments of `train` for the float MLP beside a student: new, or to be resumed.

    It begins with all walks of the student, and has its settings but for those of the network. Its
    run is in the student's, which stays the last one.
    """
    runs = run / "rival"
    if found := runs_in(runs):
        return {"recipe": None, "resume": found[0], "runs": runs}
    config = RunFolder(run).config(SparseConfig)
    own = ("policy.", "pool=", "env.name=", "recipe=", "seed=", "teacher_walks=", "noisy_walks=")
    overrides = [text for text in differences(config) if not text.startswith(own)]
    overrides += [f"pool={json.dumps(str(run))}", "teacher_walks=0", "noisy_walks=0"]
    return {
        "recipe": RIVAL, "env": config.env.name, "seed": config.seed, "runs": runs,
        "overrides": overrides,
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

    operations: of a control step, as the chip's ledger counted them in the episodes of the share;
        of float networks multiplications with inputs that are not 0
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
    shares: dict[str, float] = {}  # of levels that ended, in the episodes that decided
    for each in folder.load("last")[0].get("ended", ()):
        level = f"{LEVEL}{each['goal'] or 0:g}"
        shares[level] = max(each["share"], shares.get(level, each["share"]))
    found = []
    for level in folder.levels.values():
        state = folder.load(level)[0]
        if best.get("kept"):
            chosen = level == f"{LEVEL}{best['kept']:g}"
        else:
            chosen = bool(best) and state["updates"] == best["updates"]
        counted = best if chosen else state
        share = shares.get(level, state["eval_share"])
        found.append(Level(counted["eval_operations"], share, chosen))
    if best and not any(each.chosen for each in found):  # what was never pruned
        found.append(Level(best["eval_operations"], best["eval_share"], True))
    return sorted(found, key=lambda each: -each.operations)


def fronts(run: Path, rival: Path | None) -> dict[str, list[Level]]:
    """Return the levels of a student, and of its rival, by what they are called."""
    return {STUDENT: front(run), **({FLOAT: front(rival)} if rival else {})}


def print_fronts(found: Mapping[str, Sequence[Level]]) -> None:
    """Print the levels of student and rival, a table each."""
    from spikedeploy.reports.table import Table

    for name, levels in found.items():
        rows = [
            (f"{e.operations:,.0f}", f"{e.share:.1%}", "this" if e.chosen else "") for e in levels
        ]
        Table((_UNITS[name], "of teacher", "kept"), rows, f"{name}, validation").print()


def describe(run: Path, found: Mapping[str, Sequence[Level]]) -> str:
    """Return lines on what a student and its rival keep of the teacher, and at what cost.

    found: their levels; none where nothing was pruned

    One says so where the student has learned too little, or a budget had nothing pruned.
    """
    folder = RunFolder(run)
    if not folder.checkpoint("best").is_file():
        return ""
    c, last, best = folder.settings(), folder.load("last")[0], folder.load("best")[0]
    returns = {"teacher": last.get("teacher_return"), "student": best["eval_return"]}
    episodes = c["validation"]["episodes"]
    if found:
        returns["random actions"] = last["random_return"]
    if best.get("kept"):
        episodes = c["confirm"]
        returns["teacher"], returns["random actions"] = last["confirming"]
    numbers = ", ".join(f"{name} {each:,.4g}" for name, each in returns.items())
    lines = [f"validation, {episodes} episodes: {numbers}"]
    lines += [
        f"{name}: {e.share:.1%} of the teacher with {e.operations:,.0f} {_UNITS[name]}"
        for name, levels in found.items()
        for e in levels
        if e.chosen
    ]
    if found and best["eval_share"] < _ENOUGH:
        lines.append(
            f"it keeps only {best['eval_share']:.1%}: let it walk and learn for longer, or send "
            f"finer events: --set walks={2 * c['walks']} --set "
            f"dense_updates={2 * c['dense_updates']}, or --set step={c['step'] / 2:g} --set "
            f"policy.most={2 * c['policy']['most']}"
        )
    ended = [each["operations"] for each in last.get("ended", ()) if each["goal"] is None]
    if found and c["budget"] and ended[-1] <= c["budget"]:
        lines.append(
            f"the budget of {c['budget']:,.4g} operations did not bind: by training's estimate the "
            f"student had {ended[-1]:,.4g} before pruning"
        )
    return "".join(f"{line}\n" for line in lines)
