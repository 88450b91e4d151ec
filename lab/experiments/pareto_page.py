"""The page of the pareto experiment, results/pareto.md: a section for each environment's CSV.

Every number is of results/pareto/<env>.csv, and what made it of <env>.json beside it, so that the
page can be written again without the runs.
"""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lab.experiments import pages
from lab.experiments.costs import ACC16, ACC32, INT8, LEAN_UPDATE, TERMS, TOTALS, total
from lab.experiments.fronts import (
    Pairing,
    Point,
    is_kart,
    mean_score,
    pairing,
    pairing_at,
    points,
    read_table,
    reference_rows,
    return_estimates,
    span_at,
    write_table,
)
from lab.experiments.pages import estimate, grouped, pico
from lab.experiments.pareto import ENVS, LABELS, LAST, STUDENTS, ParetoDesign
from lab.experiments.training import Record
from spikedeploy.comparison import statistics
from spikedeploy.reports.plots import BLUE, VERMILION, save
from spikedeploy.reports.table import ABSENT
from spikedeploy.runtime.files import as_text, read_json, write_text
from spikedeploy.runtime.metrics.energy_tables import TABLES

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# shares of the teacher's score: points below the second are of no use, and not compared
NEARLY, NEAR = 0.98, 0.95
_CONSTANTS = {
    "INT8": INT8, "ACC16": ACC16, "ACC32": ACC32, "LEAN_UPDATE": LEAN_UPDATE, "NEARLY": NEARLY,
    "NEAR": NEAR, "TERMS": TERMS, "TOTALS": TOTALS, "LABELS": LABELS,
}  # fmt: skip


def write(design: ParetoDesign, results: Path) -> list[Path]:
    """Write page, table and picture of the complete parts; return the files.

    Where there are no run folders, the table that is there is kept.
    """
    found, folder = list(design.all_rows()), results / "pareto"
    table = folder / f"{design.env}.csv"
    if found or not table.is_file():
        write_table(found, table)
        write_text(table.with_suffix(".json"), as_text(_facts(design)))
    tables = {env: folder / f"{env}.csv" for env in ENVS if (folder / f"{env}.csv").is_file()}
    rows = {env: read_table(path) for env, path in tables.items()}
    by_env = {env: points(of) for env, of in rows.items()}
    drawn = {f"pareto/{env}.png": front_figure(env, of) for env, of in by_env.items()}
    picture = save(drawn[f"pareto/{design.env}.png"], table.with_suffix(".png"))
    page, shown = pages.write_page(
        results / "pareto.md",
        drawn,
        overview={env: cheapest(of) for env, of in by_env.items()},
        tasks={
            env: _task(rows[env], by_env[env], read_json(path.with_suffix(".json")))
            for env, path in tables.items()
        },
        price=lambda table, event: TABLES[table].joules[event] * pages.PICO,
        **_CONSTANTS,
    )
    return [page, table, picture, shown]


def _task(rows: list[Record], found: list[Point], made: Record) -> Record:
    """Facts that the template shows of an environment."""
    if not found:
        return made | {"levels": []}
    last, is_race = last_levels(found), any(map(is_kart, rows))
    others = points(rows, LAST)
    order = [p.student for p in last]
    count = min((len(p.teacher) for p in others), default=None)
    here = [*(_on_first_episodes(p, count) for p in last), *others]
    return made | {
        "facts": "\n".join(made["facts"]),
        "sentences": "\n".join(sentences(found)),
        "levels": found,
        "references": reference_rows(rows),
        "is_race": is_race,
        # a bootstrap of successes alone would have no interval
        "finished": lambda rows: statistics.share([s for row in rows for s in row["scores"]]),
        "returns": return_table(rows, found),
        "last": last,
        "baselines": [
            (p, [_against(pairing(found, p, of, lean)) for of, lean in _COMPARED])
            for p in found
            if p.is_spiking and p.of_teacher.mean >= NEAR
        ],
        "places": sorted(here, key=lambda p: order.index(p.student)),
        "refused": {
            place: of[-1]["refusal"]
            for place, of in grouped(filter(_refused, rows), "student", "place")
        },
    }


_COMPARED = (*((of, False) for of in TOTALS), ("all", True))  # total, and whether it is lean


def _refused(row: Record) -> bool:
    return bool(row.get("refusal"))


def _on_first_episodes(point: Point, count: int | None) -> Point:
    """A point on the episodes alone that others were evaluated on; its counts are of all."""
    rows = [{**row, "scores": row["scores"][:count]} for row in point.rows]
    return Point(rows, point.teacher[:count])


def _facts(design: ParetoDesign) -> Record:
    """Facts on the making of a table."""
    sizes = ["seeds", "episodes", "chip_episodes"]
    limit = f", of at most {design.limit} control steps" if design.limit else ""
    last = f"the last {design.levels} levels" if (design.levels or 0) > 1 else "the last level"
    levels = "every level" if design.levels is None else last
    text = pages.command(design, design.env, sizes=sizes)
    text += f" --levels {design.levels}" if design.levels else ""
    trainings = design.trainings()
    done = sum(training.is_trained for training in trainings)
    notes = [f"{done} of {len(trainings)} trainings are done."] if done < len(trainings) else []
    return {
        "command": pages.with_settings(text, design.settings),
        "chip_episodes": design.chip_episodes,
        "missing": pages.missing_text(notes, design.limit),
        "facts": [
            f"- {pages.releases('torch', 'numpy', 'mujoco')}",
            f"- training seeds 0 to {design.seeds - 1}; {design.episodes} episodes of {levels} "
            f"from seed 10,000 on, {design.chip_episodes} elsewhere{limit}",
            *pages.other_settings(trainings, pages.CHANGED),
        ],
    }


def return_table(rows: Sequence[Record], found: Sequence[Point]) -> list[list[str]]:
    """Mean return, IQM and risk of every level, of karts the share of finishes before them.

    Columns that nothing fills are left out.
    """
    is_race = any(map(is_kart, rows))
    form = ",.1f" if is_race else ",.0f"  # karts earn tens, hexapods thousands

    def cells(of: Sequence[Record]) -> list[str]:
        got = return_estimates(of)
        each = (got.mean, got.iqm, got.risk) if got else (None, None, None)
        finished = [estimate(mean_score(of), ".1%")] if is_race else []
        return [*finished, *(estimate(e, form) for e in each)]

    heads = ["policy", "aim", "training seeds", "episodes"]
    lines = [[*heads, *(["finished"] if is_race else []), "return", "IQM", "risk"]]
    for p in found:
        counts = [f"{p.level:g}", f"{len(p.rows)}", f"{len(p.teacher)}"]
        lines.append([p.label, *counts, *cells(p.rows)])
    for name, row in reference_rows(rows).items():
        counts = [ABSENT, ABSENT, f"{len(row['scores'])}"]
        lines.append([f"{name}, {row.get('place')}", *counts, *cells([row])])
    filled = [k for k, column in enumerate(zip(*lines[1:], strict=True)) if {*column} != {ABSENT}]
    return [[line[k] for k in filled] for line in lines]


def last_levels(found: Sequence[Point]) -> list[Point]:
    """The last level of each student, by imitation and with reward."""
    return list({(p.student, p.is_rewarded): p for p in found}.values())


def _against(pair: Pairing) -> str:
    if pair.baseline is None or pair.ratio is None:
        return "no float student is as good"
    mine, theirs = pair.energies
    label = f"{pair.baseline.label} {pair.baseline.level:g}"
    return f"{pico(mine)} : {pico(theirs or 0.0)} = {pair.ratio:.2f} ({label})"


def cheapest(found: Sequence[Point]) -> list[Point]:
    """Of each student, by imitation and with reward, the level with the fewest operations.

    Only levels with NEARLY of the teacher's score count; where none has it, the best one does.
    """
    groups: dict[tuple[str, bool], list[Point]] = {}
    for point in found:
        groups.setdefault((point.student, point.is_rewarded), []).append(point)
    return [
        min(near, key=lambda point: point.mean("operations") or 0.0)
        if (near := [point for point in group if point.of_teacher.mean >= NEARLY])
        else max(group, key=lambda point: point.of_teacher.mean)
        for group in groups.values()
    ]


# sentences

_WORDS = {
    "operations": "Operations alone",
    "updates": "With neuron updates",
    "all": "With updates, encoder and constants",
}
# tables in which sums are in memory, and are found by an index
_SUMS = {ACC16: "sums of 16 bits in memory", ACC32: "sums of 32 bits in memory"}
_TERM_WORDS = {
    "operations": "the operations",
    "updates": "the neuron updates",
    "traffic": "the messages",
    "encoder": "the encoder",
    "constants": "the constants",
}


def sentences(found: Sequence[Point]) -> list[str]:
    """For each total the cheapest spiking and float points that are good, and what decides."""
    lean = "The same with 16-bit states and power-of-two decays (derived)"
    asked = [(of, words, False, INT8) for of, words in _WORDS.items()]
    asked += [("all", lean, True, INT8)]
    asked += [
        (of, f"{_WORDS[of]}, {sums}", False, table)
        for table, sums in _SUMS.items()
        for of in ("operations", "all")
    ]
    return [_sentence(found, *each) for each in asked]


def _sentence(found: Sequence[Point], of: str, words: str, lean: bool, table: str) -> str:
    pairs = {part: pairing_at(found, part, of, lean, table) for part in (NEARLY, NEAR)}
    known = [pair for pair in pairs.values() if pair is not None and pair.ratio is not None]
    if not known:
        return f"- {words}: {_lack(found)}, so there is nothing to compare."
    spans = {part: span_at(found, part, of, lean, table) for part in pairs}
    parts = [
        f"for {part:.0%} of the teacher's score {_beside(pair, *spans[part])}"
        for part, pair in pairs.items()
    ]
    marks = {_mark(pair, *spans[part]) for part, pair in pairs.items() if pair in known}
    mark = marks.pop() if len(marks) == 1 else "≈"
    text = f"- {mark} {words}: {'; '.join(parts)}."
    return text if of == "operations" else f"{text} {_decides(known[0])}."


def _mark(pair: Pairing | None, least: float | None, largest: float | None) -> str:
    """✓ where the spiking point is cheaper wherever in its interval a score is, ✗ never; or ≈."""
    if largest is not None and largest <= 1:
        return "✓"
    return "✗" if ((pair.ratio if pair and least is None else least) or 0.0) > 1 else "≈"


def _beside(pair: Pairing | None, *span: float | None) -> str:
    """Energy of a spiking point beside its baseline, as the means and as the intervals have it."""

    def named(point: Point) -> str:
        return f"{point.label} at {point.level:g} ({point.of_teacher.mean:.1%})"

    if pair is None:
        return "no spiking policy is good enough"
    own, other = pair.energies
    mine = f"{named(pair.point)} costs {pico(own)} pJ"
    if pair.baseline is None or other is None:
        return f"{mine}, no float student is good enough"
    theirs = f"{named(pair.baseline)} {pico(other)} pJ"
    ends = ["?" if ratio is None else f"{ratio:.2f}" for ratio in span]
    between = "" if set(ends) == {f"{pair.ratio:.2f}"} else f" ({ends[0]} to {ends[1]})"
    return f"{mine}, {theirs}: {pair.ratio:.2f} times{between}"


def _decides(pair: Pairing) -> str:
    """Which term is most of a spiking point's energy, and what would draw a losing one level."""
    terms = pair.point.terms(pair.lean, pair.table)
    mine = {name: joules for name, joules in terms.items() if name in TOTALS[pair.of]}
    most = max(mine, key=lambda name: mine[name])
    text = f"{mine[most] / sum(mine.values()):.0%} of the first is for {_TERM_WORDS[most]}"
    own, theirs = pair.energies
    if theirs is None or own <= theirs:
        return text
    left = terms[most] - (own - theirs)
    if left <= 0:
        return f"{text}; without that it would still cost more"
    return f"{text}; it would draw level if that cost {left / terms[most]:.2f} times as much"


def _lack(found: Sequence[Point]) -> str:
    """Why nothing can be compared."""
    if not any(p.is_spiking and p.of_teacher.mean >= NEAR for p in found):
        return f"no spiking policy reaches {NEAR:.0%} of the teacher"
    if all(p.is_spiking for p in found):
        return "no float student is evaluated yet"
    return "no float student reaches the return of a spiking one"


# the picture

# distinguishable with colour blindness (Okabe and Ito 2008); markers differ too
_COLOURS = dict(zip(STUDENTS, (VERMILION, "#E69F00", "#CC79A7", BLUE, "#009E73"), strict=True))
_MARKERS = dict(zip(STUDENTS, "osvD^", strict=True))
_LOWEST = 60.0  # [%]; what is below is not drawn
_RING: dict[str, Any] = {"markersize": 9, "markeredgecolor": "#222222", "markeredgewidth": 1.4}
_Cost = Callable[[Record], float]


def front_figure(env: str, found: Sequence[Point]) -> "Figure":
    """Return in % of the teacher against operations, and against energy.

    Levels of imitation are joined by a line; one that was trained on with reward has a ring.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 4.4), layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True)
    _panel(left, found, lambda row: row["operations"])
    _panel(right, found, lambda row: 1e12 * total(row, INT8, "all"))
    left.set_xlabel("operations a control step: SOPs, or MACs with an input that is not 0")
    right.set_xlabel(f"energy a control step [pJ], {INT8}, with updates and encoder")
    left.set_ylabel("% of the teacher's finishes" if "kart" in env else "% of the teacher's return")
    artists, names = left.get_legend_handles_labels()
    figure.legend(artists, names, loc="outside upper center", ncols=len(names), frameon=False)
    return figure


def _panel(axes: "Axes", found: Sequence[Point], cost: _Cost) -> None:
    from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

    for student in STUDENTS:
        for rewarded in (False, True):
            if of := [p for p in found if (p.student, p.is_rewarded) == (student, rewarded)]:
                _draw(axes, of, cost, student, rewarded)
    if any(point.is_rewarded for point in found):
        axes.plot([], [], "o", label="with reward", **_RING, markerfacecolor="none")
    axes.axhline(100, color="#8A939E", linewidth=0.8, zorder=1)
    spent = [cost(row) for point in found for row in point.rows]
    axes.set_xscale("log")
    # scores of a teacher that scores nothing are not numbers, and would leave the axis empty
    least, most = max(min(spent, default=1.0), 1.0), max([*spent, 10.0])
    axes.set_xlim(0.8 * least, 1.25 * most)
    span = most / least
    # multiples of powers of ten that are labelled
    narrow = (1, 1.25, 1.5, 2, 2.5, 3, 4, 5, 6, 8)
    ticks = narrow if span < 4 else (1, 1.5, 2, 3, 5, 7) if span < 20 else (1, 2, 5)
    axes.xaxis.set_major_locator(LogLocator(subs=ticks))
    axes.xaxis.set_major_formatter(StrMethodFormatter("{x:,g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())
    pages.plain(axes, which="both")
    lowest = min((100 * value for p in found for value in p.single), default=_LOWEST)
    axes.set_ylim(bottom=max(_LOWEST, lowest - 1) if lowest < 100 else 95)


def _draw(axes: "Axes", of: Sequence[Point], cost: _Cost, student: str, rewarded: bool) -> None:
    """The means, joined by a line or in rings, and a thin marker for each training."""
    means = [sum(map(cost, point.rows)) / len(point.rows) for point in of]
    score = [100 * point.of_teacher.mean for point in of]
    colour, marker = _COLOURS[student], _MARKERS[student]
    if rewarded:
        axes.plot(means, score, marker, color=colour, zorder=3, **_RING)
    else:
        axes.plot(means, score, color=colour, marker=marker, linewidth=1.8, label=LABELS[student])
    for point in of:
        axes.plot(
            list(map(cost, point.rows)), [100 * value for value in point.single], marker,
            color=colour, markerfacecolor="none", markersize=4, markeredgewidth=0.7, alpha=0.8,
        )  # fmt: skip
