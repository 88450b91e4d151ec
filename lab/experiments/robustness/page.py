"""The page of the robustness experiment, results/robustness.md: a section for each CSV.

Every number is of results/robustness/<env>.csv, and what made it of <env>.json beside it, so that
the page can be written again without the runs.
"""

import json
import shlex
from pathlib import Path
from typing import Any

from lab.experiments.robustness import records, tables
from lab.experiments.robustness.design import (
    DISTURBANCE,
    ENVS,
    FAULT,
    UNDISTURBED,
    RobustnessDesign,
    file_name,
)
from lab.experiments.robustness.evaluation import all_rows, missing
from lab.experiments.robustness.plot import levels_figure
from spikedeploy.files import as_text, read_json, write_text
from spikedeploy.reports.page import write_beside
from spikedeploy.reports.plots import save
from spikedeploy.trainers.versions import installed, own

_PACKAGES = ("numpy", "mujoco", "pymunk")
_INTRODUCTION = f"""\
What is left of the return of a policy where the world or the chip is not as in training. Policies
of the five worlds are the shipped ones; none was trained for this page. Walkers other than `sac`
and `smooth` imitate these on walks without disturbances, so what float controls lose as well is
lost by imitation, not by spikes. Definitions, numbers of the levels and where they come from:
[docs/robustness.md](../docs/robustness.md).

Each cell is the return as a share of what the same policy earns undisturbed on the same seeds, with
the 95 % interval of a bootstrap in percent: over episodes, pair by pair; under faults over faulty
chips first, which differ in what is hit, and then over the episodes on each. Training seeds are not
covered. A share can be above 100 %, and below 0 where a return is. Disturbances are the same for
all policies, draw by draw; faults are of chips, so float policies have none. At level
{tables.MIDDLE} the page says where {tables.ENOUGH:.0%} is kept, by the mean."""


def write(design: RobustnessDesign, results: Path) -> list[Path]:
    """Write page, table and picture of the complete rows; return the files.

    Where there are no rows, the table that is there is kept.
    """
    found, folder = list(all_rows(design)), results / "robustness"
    table = folder / f"{file_name(design.env)}.csv"
    if found or not table.is_file():
        records.write(found, table)
        write_text(table.with_suffix(".json"), as_text(_made(design)))
    drawn = {_picture(csv.stem): levels_figure(records.read(csv)) for csv in _tables(folder)}
    picture = save(drawn[_picture(table.stem)], table.with_suffix(".png"))
    page, shown = write_beside(results / "robustness.md", text(folder), drawn)
    return [page, table, picture, shown]


def _picture(env: str) -> str:
    """Its address on the page."""
    return f"robustness/{env}.png"


def _tables(folder: Path) -> list[Path]:
    """The tables of the environments that were run: ours, then others."""
    others = sorted(path.stem for path in folder.glob("*.csv") if path.stem not in ENVS)
    found = (folder / f"{env}.csv" for env in (*ENVS, *others))
    return [path for path in found if path.is_file()]


def text(folder: Path) -> str:
    """The page, of the tables in the folder."""
    parts = ["# Robustness", _INTRODUCTION]
    for path in _tables(folder):
        made = read_json(path.with_suffix(".json"))
        parts += _section(path.stem, records.read(path), made)
    return "\n\n".join(part for part in parts if part) + "\n"


def _section(env: str, rows: list[dict[str, Any]], made: dict[str, Any]) -> list[str]:
    head = [f"## {rows[0]['env'] if rows else env}", f"    {made['command']}", made["missing"]]
    if not any(row["part"] == UNDISTURBED for row in rows):
        return [*head, "Nothing is evaluated yet."]
    loses = any((row["return_mean"] or 0) < 0 for row in rows if row["part"] == UNDISTURBED)
    disturbances, faults = (tables.kept_table(rows, part) for part in (DISTURBANCE, FAULT))
    return [
        *head,
        "\n".join(tables.sentences(rows)),
        "Returns below 0 have no shares: their cells are mean returns." if loses else "",
        f"![% of the undisturbed return against the level]({_picture(env)})",
        "### Undisturbed",
        tables.undisturbed_table(rows),
        "### Disturbances of the world" if disturbances else "",
        disturbances,
        "### Faults of the chip" if faults else "",
        faults,
        "### How this was made",
        "\n".join([*made["facts"], f"- every number: [{env}.csv](robustness/{env}.csv)"]),
    ]


def _made(design: RobustnessDesign) -> dict[str, Any]:
    """What the page says about the making of a table."""
    left = sum(missing(design, part) for part in design.parts)
    packages = ", ".join(f"{name} {installed(name)}" for name in _PACKAGES)
    limit = f", of at most {design.limit} control steps" if design.limit else ""
    return {
        "command": _command(design),
        "missing": f"**{left} of {len(design.parts)} parts are missing.**" if left else "",
        "facts": [
            f"- spikedeploy {own()}, {packages}",
            f"- {design.episodes} episodes from seed 10,000 on{limit}; under faults divided among "
            f"{design.specimens} faulty chips",
        ],
    }


def _command(design: RobustnessDesign) -> str:
    words = ["python", "-m", "lab", "experiment", "robustness", design.env]
    words += ["--quick"] if design.quick else []
    words += ["--episodes", f"{design.episodes}"]
    words += ["--chip", design.chip] if design.chip != "loihi1" else []
    words += ["--policies", ",".join(design.files)] if design.files else []
    words += [word for name, value in design.options.items() for word in _setting(name, value)]
    return shlex.join(words)


def _setting(name: str, value: Any) -> list[str]:  # noqa: ANN401
    return ["--set", f"{name}={value if isinstance(value, str) else json.dumps(value)}"]
