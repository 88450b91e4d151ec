"""The page of the robustness experiment, results/robustness.md: a section for each CSV.

Every number is of results/robustness/<env>.csv, and what made it of <env>.json beside it, so that
the page can be written again without the runs.
"""

import json
import shlex
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from lab.experiments import pages
from lab.experiments.robustness import (
    DISTURBANCE,
    ENVS,
    FAULT,
    UNDISTURBED,
    RobustnessDesign,
    file_name,
)
from lab.experiments.training import Record
from spikedeploy.comparison.statistics import grouped_ratio
from spikedeploy.files import as_text, read_json, write_text
from spikedeploy.reports.csv_rows import read_rows, write_rows
from spikedeploy.reports.plots import BLUE, VERMILION, save
from spikedeploy.reports.table import ABSENT

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MIDDLE = 2  # the level of the sentences
ENOUGH = 0.9  # of the undisturbed return
_COLUMNS = (
    "env", "policy", "kind", "chip", "part", "name", "level", "number", "unit", "episodes",
    "return_mean", "success_rate", "kept", "kept_low", "kept_high", "hit", "of", "what",
    "groups", "returns", "successes",
)  # fmt: skip
_TEXT = ("env", "policy", "kind", "chip", "part", "name", "unit", "what")


def write(design: RobustnessDesign, results: Path) -> list[Path]:
    """Write page, table and picture of the complete rows; return the files.

    Where there are no rows, the table that is there is kept.
    """
    found, folder = list(design.all_rows()), results / "robustness"
    table = folder / f"{file_name(design.env)}.csv"
    if found or not table.is_file():
        write_table(found, table)
        write_text(table.with_suffix(".json"), as_text(_made(design)))
    others = sorted(path.stem for path in folder.glob("*.csv") if path.stem not in ENVS)
    tables = {env: folder / f"{env}.csv" for env in (*ENVS, *others)}
    rows = {env: read_table(path) for env, path in tables.items() if path.is_file()}
    drawn = {f"robustness/{env}.png": levels_figure(of) for env, of in rows.items()}
    picture = save(drawn[f"robustness/{table.stem}.png"], table.with_suffix(".png"))
    page, shown = pages.write_page(
        results / "robustness.md",
        drawn,
        tasks={
            env: _task(env, of, read_json(tables[env].with_suffix(".json")))
            for env, of in rows.items()
        },
        MIDDLE=MIDDLE,
        ENOUGH=ENOUGH,
    )
    return [page, table, picture, shown]


def _task(env: str, rows: list[Record], made: Record) -> Record:
    """What the template shows of an environment."""
    calm = [row for row in rows if row["part"] == UNDISTURBED]
    return made | {
        "env": rows[0]["env"] if rows else env,
        "facts": "\n".join(made["facts"]),
        "sentences": "\n".join(sentences(rows)),
        "loses": any((row["return_mean"] or 0) < 0 for row in calm),
        "undisturbed": _undisturbed_table(calm),
        "disturbances": _kept_table(rows, DISTURBANCE),
        "faults": _kept_table(rows, FAULT),
    }


def _made(design: RobustnessDesign) -> Record:
    """What the page says about the making of a table."""
    left, of = sum(map(design.is_missing, design.names)), len(design.names)
    limit = f", of at most {design.limit} control steps" if design.limit else ""
    return {
        "command": _command(design),
        "missing": f"**{left} of {of} parts are missing.**" if left else "",
        "facts": [
            f"- {pages.releases('numpy', 'mujoco', 'pymunk')}",
            f"- {design.episodes} episodes from seed 10,000 on{limit}; under faults divided among "
            f"{design.specimens} faulty chips",
        ],
    }


def _command(design: RobustnessDesign) -> str:
    text = pages.command(design, design.env, sizes=["episodes"])
    text += f" --policies {shlex.quote(','.join(design.files))}" if design.files else ""
    values = {k: v if isinstance(v, str) else json.dumps(v) for k, v in design.options.items()}
    return pages.with_settings(text, (f"{name}={value}" for name, value in values.items()))


def write_table(found: Iterable[Record], path: Path) -> Path:
    """Write rows with what is kept; missing fields stay empty."""
    return write_rows(with_kept(list(found)), _COLUMNS, path)


def read_table(path: Path) -> list[Record]:
    """The rows of a CSV; missing fields are None."""
    return read_rows(path, _TEXT)


def with_kept(rows: Sequence[Record]) -> list[Record]:
    """The rows with the share of the undisturbed return that is kept, and its interval."""
    calm = {row["policy"]: row for row in rows if row["part"] == UNDISTURBED}
    return [row | _kept(row, calm.get(row["policy"])) for row in rows]


def _kept(row: Mapping[str, Any], calm: Mapping[str, Any] | None) -> Record:
    if calm is None or row["part"] == UNDISTURBED or np.sum(calm["returns"]) <= 0:
        return {}
    rng = np.random.default_rng(0)
    found = grouped_ratio(row["returns"], calm["returns"], row["groups"], rng)
    return {"kept": found.mean, "kept_low": found.ci95[0], "kept_high": found.ci95[1]}


def policies(rows: Sequence[Record]) -> list[str]:
    """Labels of the policies, in the order of their rows."""
    return list(dict.fromkeys(row["policy"] for row in rows))


def _undisturbed_table(calm: Sequence[Record]) -> list[list[str]]:
    """Returns and successes where nothing is wrong; empty without rows."""
    lines = [["policy", "return", "success", "episodes"]] if calm else []
    for r in calm:
        success = ABSENT if r["success_rate"] is None else f"{r['success_rate']:.0%}"
        lines.append([r["policy"], f"{r['return_mean']:,.0f}", success, f"{r['episodes']}"])
    return lines


def _kept_table(rows: Sequence[Record], part: str) -> list[list[str]]:
    """What each policy keeps at each level; empty without rows of the part."""
    found = [row for row in rows if row["part"] == part]
    names = policies(found)
    by_condition: dict[tuple[str, int], dict[str, Record]] = {}
    for row in found:
        by_condition.setdefault((row["name"], row["level"]), {})[row["policy"]] = row
    lines = [["", "number", *(["hit"] if part == FAULT else []), *names]]
    for (name, level), each in by_condition.items():
        first = next(iter(each.values()))
        hit = [_hit(each)] if part == FAULT else []
        cells = [kept(each.get(policy)) for policy in names]
        lines.append([f"{name}:{level}", f"{first['number']:g} [{first['unit']}]", *hit, *cells])
    return lines if found else []


def kept(row: Record | None) -> str:
    """`97% [95, 99]`; the return itself where it is a loss; a dash where there is no row."""
    if row is None:
        return ABSENT
    if row.get("kept") is None:
        return f"{row['return_mean']:,.0f}" if row.get("return_mean", 0) < 0 else ABSENT
    return f"{row['kept']:.0%} [{100 * row['kept_low']:.0f}, {100 * row['kept_high']:.0f}]"


def _hit(each: dict[str, Record]) -> str:
    """How much a fault hit, policy by policy."""
    hits = [f"{row['hit'] / max(row['of'], 1):.2g}" for row in each.values() if row.get("of")]
    what = next((row["what"] for row in each.values() if row.get("what")), "")
    return f"{', '.join(hits)} of {what}" if hits else ABSENT


def sentences(rows: Sequence[Record]) -> list[str]:
    """What spiking policies keep at the middle level, beside the float ANN."""
    middle = [row for row in rows if row["level"] == MIDDLE and row.get("kept") is not None]
    ann = next((row["policy"] for row in rows if row["kind"] == "ann"), None)
    found = []
    for policy in dict.fromkeys(row["policy"] for row in rows if row["kind"] == "snn"):
        own = [row for row in middle if row["policy"] == policy]
        for part, word in ((DISTURBANCE, "disturbances"), (FAULT, "faults")):
            of = [row for row in own if row["part"] == part]
            if of:
                found.append(_kept_of(policy, of, word))
        beside = _beside(own, [row for row in middle if row["policy"] == ann])
        if ann and beside is not None:
            found.append(_worse(policy, ann, beside, _controls(middle)))
    return [f"* {each}" for each in found]


def _kept_of(policy: str, rows: Sequence[Record], word: str) -> str:
    enough = [row["name"] for row in rows if row["kept"] >= ENOUGH]
    less = [f"{row['name']} {kept(row)}" for row in rows if row["kept"] < ENOUGH]
    rest = f"; less under {', '.join(less)}" if less else ""
    return (
        f"**{policy}** keeps {ENOUGH:.0%} or more of its own undisturbed return under "
        f"{len(enough)} of {len(rows)} {word} at level {MIDDLE}{rest}."
    )


def _beside(own: Sequence[Record], ann: Sequence[Record]) -> list[tuple[Record, Record]] | None:
    """Rows in which the float ANN keeps enough and the policy does not; None without an ANN."""
    if not ann:
        return None
    of_ann = {row["name"]: row for row in ann}
    return [
        (row, of_ann[row["name"]])
        for row in own
        if row["name"] in of_ann and row["kept"] < ENOUGH <= of_ann[row["name"]]["kept"]
    ]


def _controls(rows: Sequence[Record]) -> dict[str, list[str]]:
    """Condition -> what each float control keeps."""
    found: dict[str, list[str]] = {}
    for row in rows:
        if row["kind"] == "control":
            found.setdefault(row["name"], []).append(f"{row['policy']} {row['kept']:.0%}")
    return found


def _worse(
    policy: str, ann: str, pairs: Sequence[tuple[Record, Record]], controls: dict[str, list[str]]
) -> str:
    if not pairs:
        return f"Wherever {ann} keeps {ENOUGH:.0%} at level {MIDDLE}, {policy} does."
    said = ", ".join(
        f"{own['name']} ({kept(own)} against {kept(of)}"
        + "".join(f"; {control}" for control in controls.get(own["name"], ()))
        + ")"
        for own, of in pairs
    )
    return f"Where {ann} keeps {ENOUGH:.0%} at level {MIDDLE} and {policy} does not: {said}."


_PANELS = 5
_FLOATS = (BLUE, "#56B4E9", "#009E73", "#8A939E", "#000000")  # Okabe and Ito 2008
_SPIKING = (VERMILION, "#E69F00", "#CC79A7", "#F0E442")
_MARKERS = "os^Dv"


def levels_figure(rows: Sequence[Record]) -> "Figure":
    """% of the undisturbed return against the level."""
    from matplotlib.figure import Figure

    names = list(dict.fromkeys(row["name"] for row in rows if row["part"] != UNDISTURBED))
    lines = max(1, -(-len(names) // _PANELS))
    figure = Figure(figsize=(12, 2.3 * lines + 0.6), layout="constrained")
    panels = figure.subplots(lines, _PANELS, sharex=True, sharey=True, squeeze=False).flat
    looks = _looks(rows)
    for name, axes in zip(names, panels, strict=False):
        _panel(axes, name, [row for row in rows if row["name"] == name], looks)
    for axes in list(panels):
        axes.axis("off")
    handles = [
        figure.axes[0].plot([], [], color=colour, marker=marker, label=policy)[0]
        for policy, (colour, marker) in looks.items()
    ]
    figure.legend(handles=handles, loc="outside upper center", ncols=5, frameon=False)
    figure.supxlabel("level")
    figure.supylabel("% of the undisturbed return")
    return figure


def _looks(rows: Sequence[Record]) -> dict[str, tuple[str, str]]:
    """Policy -> colour and marker: warm colours spike."""
    kinds = {row["policy"]: row["kind"] for row in rows}
    found, counts = {}, {True: 0, False: 0}
    for place, policy in enumerate(policies(rows)):
        spikes = kinds[policy] == "snn"
        colours = _SPIKING if spikes else _FLOATS
        found[policy] = colours[counts[spikes] % len(colours)], _MARKERS[place % len(_MARKERS)]
        counts[spikes] += 1
    return found


def _panel(
    axes: "Axes", name: str, rows: Sequence[Record], looks: dict[str, tuple[str, str]]
) -> None:
    axes.set_title(name, fontsize=9)
    for policy, (colour, marker) in looks.items():
        of = [row for row in rows if row["policy"] == policy and row.get("kept") is not None]
        if not of:
            continue
        kept = [100.0, *(100 * row["kept"] for row in of)]
        # a bootstrap of few episodes may leave its own mean outside by rounding
        low = [0.0, *(max(0.0, 100 * (row["kept"] - row["kept_low"])) for row in of)]
        high = [0.0, *(max(0.0, 100 * (row["kept_high"] - row["kept"])) for row in of)]
        axes.errorbar(
            [0, *(row["level"] for row in of)], kept, (low, high), color=colour, marker=marker,
            markersize=4, linewidth=1.2, capsize=2,
        )  # fmt: skip
    axes.axhline(100 * ENOUGH, color="#8A939E", linewidth=0.8, linestyle=":")
    axes.set_ylim(0, 115)
    axes.set_xticks(range(4))
    pages.plain(axes)
