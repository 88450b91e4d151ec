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
    reference_row,
    reference_rows,
    return_estimates,
    span_at,
    write_table,
)
from lab.experiments.pages import estimate, grouped, number, pico, share
from lab.experiments.pareto import ENVS, LABELS, LAST, STUDENTS, ParetoDesign
from lab.experiments.training import Record
from spikedeploy.comparison import statistics
from spikedeploy.files import as_text, read_json, write_text
from spikedeploy.reports.plots import BLUE, VERMILION, save
from spikedeploy.reports.table import ABSENT
from spikedeploy.runtime.metrics.energy_tables import TABLES

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# shares of the teacher's score: points below the second are of no use, and not compared
NEARLY, NEAR = 0.98, 0.95
Lines = list[list[str]]
Span = tuple[float | None, float | None]
_Cells = dict[str, Callable[[Point], str]]


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
    drawn = {f"pareto/{env}.png": front_figure(env, points(of)) for env, of in rows.items()}
    picture = save(drawn[f"pareto/{design.env}.png"], table.with_suffix(".png"))
    page, shown = pages.write_page(
        results / "pareto.md",
        drawn,
        overview=_overview(rows),
        tasks={
            env: _task(rows[env], read_json(path.with_suffix(".json")))
            for env, path in tables.items()
        },
        price=lambda table, event: TABLES[table].joules[event] * pages.PICO,
        **{"INT8": INT8, "ACC16": ACC16, "ACC32": ACC32, "LEAN_UPDATE": LEAN_UPDATE},
        **{"NEARLY": NEARLY, "NEAR": NEAR},
    )
    return [page, table, picture, shown]


def _task(rows: list[Record], made: Record) -> Record:
    """Facts that the template shows of an environment."""
    found = points(rows)
    if not found:
        return made | {"levels": []}
    return made | {
        "facts": "\n".join(made["facts"]),
        "sentences": "\n".join(sentences(found)),
        "levels": level_table(rows, found),
        "returns": return_table(rows, found),
        "energies": _energy_table(found),
        "terms": _term_table(found),
        "baselines": _baseline_table(found),
        "places": _place_table(rows, found),
    }


def _facts(design: ParetoDesign) -> Record:
    """Facts on the making of a table."""
    sizes = ["seeds", "episodes", "chip_episodes"]
    limit = f", of at most {design.limit} control steps" if design.limit else ""
    last = f"the last {design.levels} levels" if (design.levels or 0) > 1 else "the last level"
    levels = "every level" if design.levels is None else last
    text = pages.command(design, design.env, sizes=sizes)
    text += f" --levels {design.levels}" if design.levels else ""
    changed = "✗ {} was trained with other settings than its recipe has now: "
    return {
        "command": pages.with_settings(text, design.settings),
        "chip_episodes": design.chip_episodes,
        "missing": _missing(design),
        "facts": [
            f"- {pages.releases('torch', 'numpy', 'mujoco')}",
            f"- training seeds 0 to {design.seeds - 1}; {design.episodes} episodes of {levels} "
            f"from seed 10,000 on, {design.chip_episodes} elsewhere{limit}",
            *pages.other_settings(design.trainings(), changed),
        ],
    }


def _missing(design: ParetoDesign) -> str:
    trainings = design.trainings()
    done = sum(training.is_trained for training in trainings)
    notes = [f"{done} of {len(trainings)} trainings are done."] if done < len(trainings) else []
    if design.limit:
        steps = f"{design.limit} control steps"
        notes.append(f"A quick trial, whose episodes end after {steps}: its scores say nothing.")
    return f"**{' '.join(notes)}**" if notes else ""


# levels

_ACTIVITY: _Cells = {
    "operations": lambda p: number(p.mean("operations"), ",.1f"),
    "neurons": lambda p: number(p.mean("neurons")),
    "updates": lambda p: number(p.mean("neuron_updates"), ",.1f"),
    "of readouts": lambda p: number(p.mean("readout_updates"), ",.1f"),
    "events": lambda p: number(p.mean("events"), ",.1f"),
    "spikes": lambda p: number(p.mean("spikes_out"), ",.1f") if p.is_spiking else ABSENT,
    "sparsity": lambda p: number(p.mean("sparsity"), ".1%"),
    "saturations": lambda p: number(p.mean("saturations")),
}


def level_table(rows: Sequence[Record], found: Sequence[Point]) -> Lines:
    """Score, in the words of the task, and activity of every level; the references below."""
    cells: _Cells = {
        "aim": lambda p: f"{p.level:g}",
        "seeds": lambda p: f"{len(p.rows)}",
        "% of teacher": lambda p: share(p.of_teacher),
    }
    if reference_row(rows, "reference"):
        cells["% of reference"] = lambda p: share(p.of_reference)
    cells |= (_driving(rows) if any(map(is_kart, rows)) else _WALKING) | _ACTIVITY
    lines = [["policy", *cells]]
    lines += [[p.label, *(cell(p) for cell in cells.values())] for p in found]
    for name, row in reference_rows(rows):
        own = {f"% of {name}": "100.0%"} | _own_scores(row)
        lines.append([f"{name}, {row.get('place')}", *(own.get(head, ABSENT) for head in cells)])
    return lines


_WALKING: _Cells = {
    "return": lambda p: number(p.mean("return_mean")),
    "falls": lambda p: number(p.mean("falls"), ".1%"),
}


def _driving(rows: Sequence[Record]) -> _Cells:
    teacher = (reference_row(rows) or {}).get("lap_time")

    def beside(point: Point) -> str:
        mine = point.mean("lap_time")
        return ABSENT if mine is None or teacher is None else f"{mine / teacher - 1:+.1%}"

    return {
        "finished": _finished,
        "lap [s]": lambda p: number(p.mean("lap_time"), ".3f"),
        "lap": beside,
    }


def _own_scores(row: Record) -> dict[str, str]:
    """Scores of a reference by the head of their column."""
    if not is_kart(row):
        return {"return": number(row["return_mean"]), "falls": number(row["falls"], ".1%")}
    finished = statistics.share(row["scores"]).mean
    return {"finished": f"{finished:.1%}", "lap [s]": number(row.get("lap_time"), ".3f")}


def _finished(point: Point) -> str:
    """Share of all episodes, with Wilson's interval: a bootstrap of successes alone has none."""
    return estimate(statistics.share([s for row in point.rows for s in row["scores"]]), ".1%")


def return_table(rows: Sequence[Record], found: Sequence[Point]) -> Lines:
    """Mean return, IQM and risk of every level, of karts the share of finishes before them."""
    racing = any(map(is_kart, rows))
    form = ",.1f" if racing else ",.0f"  # karts earn tens, hexapods thousands

    def cells(of: Sequence[Record]) -> list[str]:
        got = return_estimates(of)
        each = (got.mean, got.iqm, got.risk) if got else (None, None, None)
        finished = [estimate(mean_score(of), ".1%")] if racing else []
        return [*finished, *(estimate(e, form) for e in each)]

    heads = ["policy", "aim", "training seeds", "episodes"]
    lines = [[*heads, *(["finished"] if racing else []), "return", "IQM", "risk"]]
    for p in found:
        counts = [f"{p.level:g}", f"{len(p.rows)}", f"{len(p.teacher)}"]
        lines.append([p.label, *counts, *cells(p.rows)])
    for name, row in reference_rows(rows):
        counts = [ABSENT, ABSENT, f"{len(row['scores'])}"]
        lines.append([f"{name}, {row.get('place')}", *counts, *cells([row])])
    filled = [k for k, column in enumerate(zip(*lines[1:], strict=True)) if {*column} != {ABSENT}]
    return [[line[k] for k in filled] for line in lines]


# energies

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


def _mean_of_teacher(point: Point) -> str:
    """Without the interval; a dash where the teacher scores nothing."""
    return share(statistics.Estimate(point.of_teacher.mean, (float("nan"), float("nan"))))


def _energy_table(found: Sequence[Point]) -> Lines:
    """Energies of every level, total by total."""
    sums = [f"{head}, {words}" for words in _SUMS.values() for head in ("operations", "all")]
    lines = [[
        "policy", "aim", "% of teacher", "operations alone", "+ neuron updates", "+ the rest",
        "+ lean updates", "lean, + the rest", *sums, "davies2018", "sanafe",
    ]]  # fmt: skip
    for p in found:
        cells = [p.energy(of) for of in TOTALS]
        cells += [p.energy(of, lean=True) for of in ("updates", "all")]
        cells += [p.energy(of, table) for table in _SUMS for of in ("operations", "all")]
        chips = ["davies2018", "sanafe"]
        priced = [pico(p.energy("all", t)) if p.is_spiking else ABSENT for t in chips]
        lines.append([p.label, f"{p.level:g}", _mean_of_teacher(p), *map(pico, cells), *priced])
    return lines


def _term_table(found: Sequence[Point]) -> Lines:
    """Energy of each term of the last level of each student, by imitation and with reward."""
    lines = [["policy", "aim", *TERMS, "lean updates"]]
    for p in last_levels(found):
        cells = [*p.terms().values(), p.terms(lean=True)["updates"]]
        lines.append([p.label, f"{p.level:g}", *map(pico, cells)])
    return lines


def last_levels(found: Sequence[Point]) -> list[Point]:
    """The last level of each student, by imitation and with reward."""
    return list({(p.student, p.is_rewarded): p for p in found}.values())


def _baseline_table(found: Sequence[Point]) -> Lines:
    """Every spiking point near the teacher beside its cheapest float baseline."""
    lines = [["policy", "aim", "% of teacher", *(w.lower() for w in _WORDS.values()), "lean, all"]]
    for point in found:
        if point.is_spiking and point.of_teacher.mean >= NEAR:
            pairs = [pairing(found, point, of) for of in TOTALS]
            pairs.append(pairing(found, point, "all", lean=True))
            cells = [point.label, f"{point.level:g}", _mean_of_teacher(point)]
            lines.append([*cells, *map(_against, pairs)])
    return lines


def _against(pair: Pairing) -> str:
    if pair.baseline is None or pair.ratio is None:
        return "no float student is as good"
    mine, theirs = pair.energies
    label = f"{pair.baseline.label} {pair.baseline.level:g}"
    return f"{pico(mine)} : {pico(theirs or 0.0)} = {pair.ratio:.2f} ({label})"


def sentences(found: Sequence[Point]) -> list[str]:
    """For each total the cheapest spiking and float points that are good, and what decides."""
    lean = "The same with 16-bit states and power-of-two decays (derived)"
    return [
        *(_sentence(found, of, words, lean=False) for of, words in _WORDS.items()),
        _sentence(found, "all", lean, lean=True),
        *(
            _sentence(found, of, f"{_WORDS[of]}, {sums}", lean=False, table=table)
            for table, sums in _SUMS.items()
            for of in ("operations", "all")
        ),
    ]


def _sentence(found: Sequence[Point], of: str, words: str, lean: bool, table: str = INT8) -> str:
    pairs = {part: pairing_at(found, part, of, lean, table) for part in (NEARLY, NEAR)}
    known = [pair for pair in pairs.values() if pair is not None and pair.ratio is not None]
    if not known:
        return f"- {words}: {_lack(found)}, so there is nothing to compare."
    spans = {part: span_at(found, part, of, lean, table) for part in pairs}
    parts = [
        f"for {part:.0%} of the teacher's score {_beside(pair, spans[part])}"
        for part, pair in pairs.items()
    ]
    marks = {_mark(pair, spans[part]) for part, pair in pairs.items() if pair in known}
    mark = marks.pop() if len(marks) == 1 else "≈"
    text = f"- {mark} {words}: {'; '.join(parts)}."
    return text if of == "operations" else f"{text} {_decides(known[0])}."


def _mark(pair: Pairing | None, span: Span) -> str:
    """✓ where the spiking point is cheaper wherever in its interval a score is, ✗ never; or ≈."""
    least, largest = span
    if largest is not None and largest <= 1:
        return "✓"
    return "✗" if ((pair.ratio if pair and least is None else least) or 0.0) > 1 else "≈"


def _beside(pair: Pairing | None, span: Span) -> str:
    """Energy of a spiking point beside its baseline, as the means and as the intervals have it."""
    if pair is None:
        return "no spiking policy is good enough"
    own, other = pair.energies
    mine = f"{_named(pair.point)} costs {pico(own)} pJ"
    if pair.baseline is None or other is None:
        return f"{mine}, no float student is good enough"
    theirs = f"{_named(pair.baseline)} {pico(other)} pJ"
    ends = ["?" if ratio is None else f"{ratio:.2f}" for ratio in span]
    between = "" if set(ends) == {f"{pair.ratio:.2f}"} else f" ({ends[0]} to {ends[1]})"
    return f"{mine}, {theirs}: {pair.ratio:.2f} times{between}"


def _named(point: Point) -> str:
    return f"{point.label} at {point.level:g} ({point.of_teacher.mean:.1%})"


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


def _place_table(rows: Sequence[Record], found: Sequence[Point]) -> Lines:
    """The last level of each student on other chips and in fewer bits."""
    here, last = points(rows, LAST), last_levels(found)
    lines = [["policy", "aim", "where", "% of teacher", "operations", "saturations"]]
    order = [p.student for p in last]
    levels = [_first_episodes(p, here) for p in last]
    for p in sorted([*levels, *here], key=lambda p: order.index(p.student)):
        more = " + readouts on the host" if p.mean("on_host") else ""
        counts = [number(p.mean("operations"), ",.1f") + more, number(p.mean("saturations"))]
        lines.append([p.label, f"{p.level:g}", p.place, share(p.of_teacher), *counts])
    for (student, place), of in grouped(filter(_refused, rows), "student", "place"):
        why = f"refused: {of[-1]['refusal']}"
        lines.append([LABELS[student], ABSENT, place, why, ABSENT, ABSENT])
    return lines


def _refused(row: Record) -> bool:
    return bool(row.get("refusal"))


def _first_episodes(point: Point, others: Sequence[Point]) -> Point:
    """A point on the episodes alone that others were evaluated on; its counts are of all."""
    count = min((len(p.teacher) for p in others), default=len(point.teacher))
    rows = [{**row, "scores": row["scores"][:count]} for row in point.rows]
    return Point(point.student, point.level, point.place, rows, point.teacher[:count])


# all tasks


def _overview(tables: dict[str, list[Record]]) -> Lines:
    """Of each student of each task the cheapest level that is nearly as good."""
    lines = [[
        "task", "policy", "aim", "seeds", "% of teacher", "% of reference", "operations",
        "neurons", "sparsity", "operations alone [pJ]", "+ updates", "+ the rest",
    ]]  # fmt: skip
    for env, rows in tables.items():
        lines += [
            [
                env, p.label, f"{p.level:g}", f"{len(p.rows)}", share(p.of_teacher),
                share(p.of_reference), number(p.mean("operations"), ",.1f"),
                number(p.mean("neurons")), number(p.mean("sparsity"), ".1%"),
                *(pico(p.energy(of)) for of in TOTALS),
            ]
            for p in cheapest(points(rows))
        ]  # fmt: skip
    return lines


def cheapest(found: Sequence[Point]) -> list[Point]:
    """Of each student, by imitation and with reward, the level with the fewest operations.

    Only levels with NEARLY of the teacher's score count; where none has it, the best one does.
    """
    groups: dict[tuple[str, bool], list[Point]] = {}
    for point in found:
        groups.setdefault((point.student, point.is_rewarded), []).append(point)
    return [_cheapest(group) for group in groups.values()]


def _cheapest(group: Sequence[Point]) -> Point:
    near = [point for point in group if point.of_teacher.mean >= NEARLY]
    if not near:
        return max(group, key=lambda point: point.of_teacher.mean)
    return min(near, key=lambda point: point.mean("operations") or 0.0)


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
    axes.xaxis.set_major_locator(LogLocator(subs=_ticks(most / least)))
    axes.xaxis.set_major_formatter(StrMethodFormatter("{x:,g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())
    pages.plain(axes, which="both")
    lowest = min((100 * value for p in found for value in p.single), default=_LOWEST)
    axes.set_ylim(bottom=max(_LOWEST, lowest - 1) if lowest < 100 else 95)


def _ticks(span: float) -> tuple[float, ...]:
    """Multiples of powers of ten that are labelled on an axis whose ends have this ratio."""
    if span < 4:
        return (1, 1.25, 1.5, 2, 2.5, 3, 4, 5, 6, 8)
    return (1, 1.5, 2, 3, 5, 7) if span < 20 else (1, 2, 5)


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
