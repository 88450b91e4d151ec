"""The page of the map of kart-eye: what costs less in each cell, and the border by the rule."""

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lab.experiments import eye_costs, pages
from lab.experiments.eye_costs import ACCOUNTINGS, Accounting, border, latency, power, predict
from lab.experiments.eye_map import MAP
from lab.experiments.pages import grouped
from lab.experiments.runner import command_line
from lab.experiments.training import Record
from lab.experiments.vision import WAYS, chip_of, own_way
from spikedeploy.comparison.statistics import Estimate, stratified_bootstrap
from spikedeploy.reports.plots import save
from spikedeploy.runtime.metrics.energy_tables import STATIC

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# share of episodes that a policy of equal success may finish less than the reference
EQUAL = 0.02
_SURE = 0.95  # share of resampled courses in which a spiking policy must equal the reference
_SOON = 0.1  # share of a control step [1] that decides nothing: waits differ from drive to drive
_RESAMPLES = 2_000  # of the courses
_FINE = 48  # points of the predicted border on an axis


@dataclass(frozen=True)
class Group:
    """Trainings of a policy in a cell: rows of one recipe and way that differ in their seeds."""

    rows: Sequence[Record]

    @property
    def key(self) -> tuple[str, str]:
        """Policy and way, or chip."""
        return self.rows[0]["policy"], self.rows[0]["way"]

    @property
    def own_way(self) -> str:
        """The way, or the chip, at whatever rate it runs."""
        return own_way(self.key[1])

    @property
    def running_key(self) -> tuple[str, str]:
        """The key of the same policy and way where it may run in each control step."""
        if self.own_way not in WAYS:
            return self.key[0], self.own_way
        often = replace(WAYS[self.own_way], every=1)
        return self.key[0], next(name for name, way in WAYS.items() if way == often)

    @property
    def run_rate(self) -> int | None:
        """Rate [Hz] at which it runs whatever the control rate is; None where by this."""
        return self.rows[0]["trained_rate"] if self.own_way != self.key[1] else None

    @property
    def name(self) -> str:
        """`kart-eye-cnn, zero-skipping`."""
        return ", ".join(self.key)

    @property
    def finished(self) -> float:
        """Share of episodes that were finished."""
        return self.mean("finished")

    def mean(self, field: str) -> float:
        """Mean of a field over the trainings."""
        return float(np.mean([row[field] for row in self.rows]))

    @property
    def latency(self) -> float:
        """Mean time [s] from an event to an action that follows from it, computing apart."""
        return float(np.mean([latency(row) for row in self.rows]))

    def acts_as_soon_as(self, other: "Group") -> bool:
        """Return whether its actions follow events no later than the other's, or a control step."""
        step = 1 / self.rows[0]["rate"]
        return bool(self.latency <= max(other.latency, step) + _SOON * step)

    def finish_differences(self, other: "Group") -> NDArray[np.float64] | None:
        """Finishes less those of another group (E,), of each course; None with nothing in common.

        Means over the seeds and the shares of quiet in which both have driven it.
        """
        theirs = {(row["seed"], row["quiet"]): row["finishes"] for row in other.rows}
        pairs = [
            (row["finishes"], theirs[place])
            for row in self.rows
            if (place := (row["seed"], row["quiet"])) in theirs
        ]
        return np.mean([np.subtract(*pair) for pair in pairs], 0) if pairs else None

    def power(self, accounting: Accounting) -> float:
        """Mean power [W]."""
        return float(np.mean([power(row, accounting) for row in self.rows]))

    def predicted(
        self, rest: "Group", way: str, accounting: Accounting, rate: float, events: float,
        span: float,
    ) -> float:  # fmt: skip
        """Mean power [W] elsewhere, from the counts of these rows and of those with most quiet."""
        resting = {row["seed"]: row for row in rest.rows}
        found = (
            predict({**r, "way": way}, resting.get(r["seed"], r), rate, events, span)
            for r in self.rows
        )
        return float(np.mean([power(row, accounting) for row in found]))


# policy and way -> what the rule starts from, at the rate of its training: no quiet, and most
References = dict[tuple[str, str], tuple[Group, Group]]


@dataclass(frozen=True)
class Success:
    """Finishes at a control rate; a cell alone has too few episodes.

    groups  by policy and way: rows of all shares of quiet that were driven
    """

    groups: Mapping[tuple[str, str], Group]

    @cached_property
    def reference(self) -> Group:
        """The float network whose finishes others must equal; else the one that finishes most.

        At the rate of its training, whatever the control rate is.
        """
        floats = [group for group in self.groups.values() if not group.rows[0]["spiking"]]
        usual = [group for group in floats if group.own_way == MAP["ways"][0]] or floats
        usual = [group for group in usual if group.run_rate] or usual
        named = [group for group in usual if group.key[0] == MAP["reference"]]
        return max(named or usual, key=lambda group: group.finished)

    @cached_property
    def _differences(self) -> Mapping[tuple[str, str], NDArray[np.float64]]:
        found = {k: each.finish_differences(self.reference) for k, each in self.groups.items()}
        return {key: each for key, each in found.items() if each is not None}

    @cached_property
    def _resampled(self) -> Mapping[tuple[str, str], NDArray[np.bool_]]:
        rng, found = np.random.default_rng(0), self._differences
        count = len(next(iter(found.values())))
        drawn = rng.integers(count, size=(_RESAMPLES, count))
        return {key: each[drawn].mean(1) >= -EQUAL for key, each in found.items()}

    def equals(self, group: Group) -> bool:
        """Return whether it finishes as many episodes as the reference, but for EQUAL."""
        found = self._differences.get(group.key)
        return found is not None and bool(found.mean() >= -EQUAL)

    def resampled(self, group: Group) -> NDArray[np.bool_]:
        """Whether it does in resampled courses (n,), the same for all groups."""
        return self._resampled.get(group.key, np.zeros(_RESAMPLES, np.bool_))


@dataclass(frozen=True)
class Cell:
    """A cell of the map by an accounting: the cheapest of equal success of either kind.

    events     of the camera a second
    spiking    the cheapest group that runs in each control step and equals the reference; where
               none does the one that finishes most
    is_equal   whether it does
    later      the cheapest group that equals the reference however often it runs; None where none
               does
    success    at the control rate
    others     float groups that equal the reference
    resampled  ratios of power where other courses decide what equals the reference, of those in
               which a spiking group does
    predicted  power of spiking over float [1], by the rule
    """

    rate: int
    quiet: float
    events: float
    others: Sequence[Group]
    spiking: Group
    is_equal: bool
    later: Group | None
    success: Success
    resampled: NDArray[np.float64]
    accounting: Accounting
    predicted: float

    @property
    def is_driven(self) -> bool:
        """Whether karts waited as long, and not for less, from which its counts follow."""
        return all(row["driven_quiet"] == self.quiet for row in self.spiking.rows)

    @cached_property
    def rivals(self) -> Sequence[Group]:
        """Those of the others that act no later, on average; the soonest where all do."""
        soon = [group for group in self.others if group.acts_as_soon_as(self.spiking)]
        return soon or [min(self.others, key=lambda group: group.latency)]

    @cached_property
    def rival(self) -> Group:
        """The cheapest of them."""
        return min(self.rivals, key=lambda group: group.power(self.accounting))

    @property
    def ratio(self) -> float:
        """Power of spiking over float [1], as counted."""
        return self.spiking.power(self.accounting) / self.rival.power(self.accounting)

    @property
    def prompt_ratio(self) -> float | None:
        """The same beside float networks alone that act as soon; None where none does."""
        latest = self.spiking.latency + _SOON / self.rate
        soon = [group.power(self.accounting) for group in self.others if group.latency <= latest]
        return self.spiking.power(self.accounting) / min(soon) if soon else None

    @property
    def register_ratio(self) -> float:
        """The same where sums of float networks are in registers, wherever those of spiking are."""
        other = replace(self.accounting, gathers=True)
        return self.spiking.power(self.accounting) / min(g.power(other) for g in self.rivals)

    @property
    def later_ratio(self) -> float | None:
        """The same where both may act later; None where no spiking policy has equal success."""
        if self.later is None:
            return None
        return self.later.power(self.accounting) / self.later_rival.power(self.accounting)

    @property
    def later_rival(self) -> Group:
        """The cheapest of the others, whenever it acts."""
        return min(self.others, key=lambda group: group.power(self.accounting))

    @property
    def difference(self) -> Estimate | None:
        """Finishes of spiking less those of the rival [1]; None with nothing in common.

        At the control rate, in all shares of quiet that were driven.
        """
        groups = self.success.groups
        found = groups[self.spiking.key].finish_differences(groups[self.rival.key])
        if found is None:
            return None
        return stratified_bootstrap([found.tolist()], np.random.default_rng(0)).mean

    @property
    def interval(self) -> tuple[float, float] | None:
        """Bounds of the ratio [1] by courses; None where no spiking policy equals the reference."""
        if not self.is_equal:
            return None
        low, high = np.quantile(self.resampled, (0.025, 0.975))
        return float(low), float(high)

    @property
    def verdict(self) -> str:
        """The kind that costs less, as far as the courses tell."""
        if self.interval is None:
            return "no spiking policy"
        low, high = self.interval
        if self.equal_share < _SURE:
            return "undecided"
        return "spiking" if high < 1 else "float" if low > 1 else "undecided"

    @property
    def equal_share(self) -> float:
        """Share of resampled courses [1] in which a spiking policy equals the reference."""
        return len(self.resampled) / _RESAMPLES

    @property
    def microwatts(self) -> tuple[float, float]:
        """Power of spiking and of float [uW]."""
        spiking, rival = (g.power(self.accounting) for g in (self.spiking, self.rival))
        return 1e6 * spiking, 1e6 * rival


@dataclass(frozen=True)
class Map:
    """All cells by an accounting; rates and shares of quiet ascend.

    cells  (rates, shares); None where a policy is missing
    """

    accounting: Accounting
    rates: Sequence[int]
    quiet: Sequence[float]
    cells: Sequence[Sequence[Cell | None]]
    references: "References"

    @property
    def has_border(self) -> bool:
        """Whether each kind costs less in some cell."""
        verdicts = {cell.verdict for row in self.cells for cell in row if cell is not None}
        return {"spiking", "float"} <= verdicts

    def predicted_border(self, column: int) -> float:
        """Control rate [Hz] from which spiking costs less by the rule, of cells of equal success.

        nan where none is.
        """
        some = [(r, row[column]) for r, row in zip(self.rates, self.cells, strict=True)]
        there = [(rate, cell) for rate, cell in some if cell is not None and cell.is_equal]
        if not there:
            return math.nan
        return border([rate for rate, _ in there], [cell.predicted for _, cell in there])

    def fine(self) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
        """Rates (n,), shares of motion (n,), and logarithms of predicted ratios (n, n) there.

        nan where no spiking policy of the nearest cell has equal success.
        """
        found = [cell for row in self.cells for cell in row if cell is not None]
        rates = np.geomspace(self.rates[0], self.rates[-1], _FINE)
        moving = np.geomspace(1 - self.quiet[-1], 1 - self.quiet[0], _FINE)
        ratios = np.zeros((_FINE, _FINE))
        for i, rate in enumerate(rates):
            for k, share in enumerate(moving):
                near = min(found, key=lambda c: _distance(c, rate, share))
                if not near.is_equal:
                    ratios[k, i] = math.nan
                    continue
                column = [c for c in found if c.rate == near.rate]
                events = np.interp(1 - share, [c.quiet for c in column], [c.events for c in column])
                groups = (near.spiking, *near.rivals)
                mine, *others = (
                    _predicted(self.references, g, self.accounting, float(rate), float(events))
                    for g in groups
                )
                ratios[k, i] = math.log(mine / min(others))
        return rates, moving, ratios


def _predicted(
    references: "References", group: Group, accounting: Accounting, rate: float, events: float
) -> float:
    """Power [W] of a group at another rate, by the rule."""
    moving, resting = references[group.running_key]
    rate = group.run_rate or rate
    # events that a float group sees are those of a control step of its training, at least
    span = float(max(1 / rate, group.rows[0]["span"]))
    return moving.predicted(resting, group.own_way, accounting, rate, events, span)


def _distance(cell: Cell, rate: float, moving: float) -> float:
    return float(abs(math.log(cell.rate / rate)) + abs(math.log((1 - cell.quiet) / moving)))


def _groups(rows: Iterable[Record]) -> list[Group]:
    return [Group(each) for _, each in grouped(rows, "policy", "way")]


def maps(rows: Sequence[Record]) -> list[Map]:
    """The map by each accounting whose chip a policy ran on."""
    rates = sorted({row["rate"] for row in rows})
    quiet = sorted({row["quiet"] for row in rows})
    cells = {place: _groups(found) for place, found in grouped(rows, "rate", "quiet")}
    found = []
    # the rule takes the counts at the rate of the training, without quiet and with most
    own = [row for row in rows if row["rate"] == row["trained_rate"]]
    first, last = (
        {group.key: group for group in _groups(row for row in own if [row["quiet"]] == end)}
        for end in (quiet[:1], quiet[-1:])
    )
    references = {key: (each, last[key]) for key, each in first.items() if key in last}
    driven = [row for row in rows if row["quiet"] == row["driven_quiet"]]
    success = {
        rate: Success({group.key: group for group in _groups(of)})
        for rate, of in grouped(driven, "rate")
    }
    for accounting in ACCOUNTINGS.values():
        table = [
            [
                _cell(rate, q, cells.get((rate, q), []), success[rate], accounting, references)
                for q in quiet
            ]
            for rate in rates
        ]
        if any(cell is not None for row in table for cell in row):
            found.append(Map(accounting, rates, quiet, table, references))
    return found


def _cell(
    rate: int, quiet: float, groups: Sequence[Group], success: Success, accounting: Accounting,
    references: "References",
) -> Cell | None:  # fmt: skip
    known = [group for group in groups if group.running_key in references]
    floats = [group for group in known if not group.rows[0]["spiking"]]
    spiking = [group for group in known if chip_of(group.key[1]) == accounting.place]
    if not floats or all(group.run_rate for group in spiking):
        return None
    able = [group for group in spiking if success.equals(group)]
    later = min(able, key=lambda group: group.power(accounting), default=None)
    prompt = [group for group in spiking if group.run_rate is None]
    equal = [group for group in prompt if success.equals(group)]
    mine = (
        min(equal, key=lambda group: group.power(accounting))
        if equal
        else max(prompt, key=lambda group: success.groups[group.key].finished)
    )
    rivals = [group for group in floats if success.equals(group)]
    events = float(np.mean([group.mean("events") * rate for group in (mine, *rivals)]))
    cell = Cell(
        rate, quiet, events, rivals, mine, bool(equal), later, success,
        _resampled_ratios(prompt, floats, success, accounting), accounting, 0.0,
    )  # fmt: skip
    expected, *others = (
        _predicted(references, g, accounting, rate, events) for g in (mine, *cell.rivals)
    )
    return replace(cell, predicted=expected / min(others))


def _resampled_ratios(
    spiking: Sequence[Group], floats: Sequence[Group], success: Success, accounting: Accounting
) -> NDArray[np.float64]:
    """Power of the cheapest spiking group over that of its rival, as in Cell, (n,).

    Of resampled courses, which decide what equals the reference; without those in which no spiking
    group does.
    """
    mine, rivals = np.full((2, _RESAMPLES), math.inf)
    for group in sorted(spiking, key=lambda group: -group.power(accounting)):
        cheapest, soonest = np.full((2, _RESAMPLES), math.inf)
        for other in sorted(floats, key=lambda other: -other.latency):
            is_equal, spent = success.resampled(other), other.power(accounting)
            soonest[is_equal] = spent
            if other.acts_as_soon_as(group):
                cheapest[is_equal] = np.minimum(cheapest[is_equal], spent)
        is_equal = success.resampled(group)
        mine[is_equal] = group.power(accounting)
        rivals[is_equal] = np.where(np.isfinite(cheapest), cheapest, soonest)[is_equal]
    there = np.isfinite(mine)
    found: NDArray[np.float64] = mine[there] / rivals[there]
    return found


# the picture

_TEXT = 13  # [pt]
_INSIDE = "#111111"  # of what stands in a cell, which is light by day and by night
_GREY = "#777777"  # of lines in the legend, by day and by night
_OPEN, _PALE = "#E4E4E0", 0.35  # colour of cells that are undecided, and share of their own in it
_MOST = 3.0  # powers of 2 that colours tell apart


def figure(found: Sequence[Map], later: bool = False) -> "Figure":
    """A panel for each accounting: control rate across, quiet upwards.

    later: whether both may run less often than in each control step
    """
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    columns = min(3, len(found))
    lines = math.ceil(len(found) / columns)
    made = Figure(figsize=(5.2 * columns, 4.4 * lines + 1), layout="constrained")
    grid = made.subplots(lines, columns, sharex=True, sharey=True, squeeze=False)
    for axes, each in zip(grid.flat, found, strict=False):
        _panel(axes, each, later)
    for axes in grid.flat[len(found) :]:
        axes.set_axis_off()
    predicted = Line2D([], [], color=_GREY, linewidth=2.5, linestyle="--", label="by the rule")
    counted = Line2D([], [], color=_GREY, linewidth=3, label="border, as counted")
    lines_drawn = [counted] if later else [counted, predicted]
    handles = [
        *(lines_drawn if any(each.has_border for each in found) else []),
        Patch(facecolor="#9CC4E0", label="spiking costs less"),
        Patch(facecolor="#F2B48A", label="float costs less"),
        *([] if later else [Patch(facecolor=_OPEN, label="undecided")]),
        Patch(
            facecolor="#FFFFFF",
            edgecolor=_GREY,
            hatch="///",
            label="no spiking policy finishes as many",
        ),
    ]
    made.legend(handles=handles, loc="outside upper center", ncols=4, frameon=False, fontsize=_TEXT)
    made.supxlabel("control rate [Hz]", fontsize=_TEXT)
    made.supylabel("share of the time in which the kart waits", fontsize=_TEXT)
    return made


def _panel(axes: "Axes", drawn: Map, later: bool) -> None:
    from matplotlib.colors import LinearSegmentedColormap, to_rgba
    from matplotlib.patches import Rectangle
    from matplotlib.ticker import FixedLocator, NullLocator

    colours = LinearSegmentedColormap.from_list("sides", ["#5B9BC8", "#F7F7F5", "#E58A4E"])
    x, y = np.log(drawn.rates), -np.log(1 - np.array(drawn.quiet))
    left, low = _edges(x), _edges(y)
    counted = np.full((len(y), len(x)), np.nan)
    for i, row in enumerate(drawn.cells):
        for k, cell in enumerate(row):
            if cell is None:
                continue
            place = (left[i], low[k]), left[i + 1] - left[i], low[k + 1] - low[k]
            ratio = cell.later_ratio if later else cell.ratio if cell.is_equal else None
            if ratio is None:
                axes.add_patch(
                    Rectangle(*place, facecolor="#FFFFFF", edgecolor="#BBBBBB", hatch="//")
                )
                continue
            is_open = not later and cell.verdict == "undecided"
            shade = np.array(colours(0.5 + math.log2(ratio) / (2 * _MOST)))
            if is_open:
                shade = _PALE * shade + (1 - _PALE) * np.array(to_rgba(_OPEN))
            axes.add_patch(Rectangle(*place, facecolor=shade, edgecolor="#FFFFFF", linewidth=1))
            shown = f"{ratio:.2g}"
            if not later and cell.interval is not None:
                shown += f"\n{cell.interval[0]:.2g} to {cell.interval[1]:.2g}"
            axes.text(
                x[i], y[k], shown, ha="center", va="center", color=_INSIDE, fontsize=_TEXT - 1,
                zorder=5, bbox={"facecolor": shade, "edgecolor": "none", "pad": 1},
            )  # fmt: skip
            counted[k, i] = math.log(ratio)
    drawn_lines = [((x, y, counted), "-", 3.0)] if drawn.has_border else []
    if drawn.has_border and not later:
        rates, moving, ratios = drawn.fine()
        drawn_lines.append(((np.log(rates), -np.log(moving), ratios), "--", 2.5))
    for (across, up, values), style, width in drawn_lines:
        known = values[np.isfinite(values)]
        if min(values.shape) > 1 and len(known) and known.min() < 0 < known.max():
            axes.contour(
                across, up, values, [0.0], colors=_INSIDE, linestyles=style, linewidths=width
            )
    axes.set_xlim(left[0], left[-1])
    axes.set_ylim(low[0], low[-1])
    axes.xaxis.set_major_locator(FixedLocator(x.tolist()))
    axes.yaxis.set_major_locator(FixedLocator(y.tolist()))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.set_xticklabels([f"{rate}" for rate in drawn.rates])
    axes.set_yticklabels([f"{share:.0%}" for share in drawn.quiet])
    axes.tick_params(labelsize=_TEXT)
    axes.set_title(drawn.accounting.title, fontsize=_TEXT)
    axes.spines[["top", "right"]].set_visible(False)


def _edges(centres: NDArray[Any]) -> NDArray[Any]:
    """Edges (n + 1,) half-way between centres (n,)."""
    if len(centres) == 1:
        return np.array([centres[0] - 0.5, centres[0] + 0.5])
    middle = (centres[1:] + centres[:-1]) / 2
    return np.array([2 * centres[0] - middle[0], *middle, 2 * centres[-1] - middle[-1]])


# the page


def errors(found: Map) -> list[float]:
    """Power by the rule over power as counted [1], ascending, of each policy by itself.

    In driven cells other than those whose counts the rule has.
    """
    cells = [cell for row in found.cells for cell in row if cell is not None and cell.is_driven]
    ends = (found.quiet[0], found.quiet[-1])
    return sorted(
        _predicted(found.references, group, found.accounting, cell.rate, cell.events)
        / group.power(found.accounting)
        for cell in cells
        for group in (cell.spiking, *cell.others)
        if group.key in found.references
        and not (cell.rate == group.rows[0]["trained_rate"] and cell.quiet in ends)
    )


def summary(found: Map) -> str:
    """A sentence on an accounting: in how many cells which kind costs less."""
    cells = [cell for row in found.cells for cell in row if cell is not None]
    counts = Counter(cell.verdict for cell in cells)
    equal = [cell for cell in cells if cell.is_equal]
    said = (
        f"{found.accounting.title}: of {len(cells)} cells spiking costs less in "
        f"{counts['spiking']}, float in {counts['float']}, {counts['undecided']} are undecided, "
        f"and in {counts['no spiking policy']} no spiking policy has equal success"
    )
    if not equal:
        return f"{said}."
    ratios = sorted(cell.ratio for cell in equal)
    saved = max((rival - mine for mine, rival in (cell.microwatts for cell in equal)), default=0.0)
    idle = [1e3 * each.watts for each in STATIC.get(found.accounting.place, ())]
    beside = f"; the chip idles at {min(idle):,.3g} mW or more" if idle else ""
    gathered = sorted(cell.register_ratio for cell in equal)
    other = (
        f" ({gathered[0]:.2f} to {gathered[-1]:.2f} if float networks keep their sums in registers)"
        if max(cell.register_ratio / cell.ratio for cell in equal) > 1 + 1e-6
        else ""
    )
    return (
        f"{said}. Ratios are {ratios[0]:.2f} to {ratios[-1]:.2f}{other}, and the most that spiking "
        f"saves is {max(saved, 0.0):.3g} \N{MICRO SIGN}W{beside}."
    )


def rate_text(rate: float) -> str:
    """A border: `310 Hz`, `everywhere`, `never`, or `–` where nothing can be said."""
    if math.isnan(rate):
        return "–"
    return "everywhere" if rate == 0 else "never" if math.isinf(rate) else f"{rate:,.0f} Hz"


def write(
    rows: Sequence[Record],
    results: Path,
    missing: int,
    limit: int | None,
    deviations: Sequence[float],
) -> list[Path]:
    """Write the page with its picture; return the files, the page first.

    deviations  sorted; operations of driven cells over those that were derived
    """
    found = maps(rows)
    names = {"kart-eye-map.png": False, "kart-eye-map-later.png": True}
    drawn = {name: figure(found, later) for name, later in names.items()} if found else {}
    notes = [f"{missing} parts are missing."] if missing else []
    page, shown = pages.write_page(
        results / "kart-eye-map.md",
        drawn,
        command=command_line(),
        missing=pages.missing_text(notes, limit),
        maps=found,
        groups=[Group(each) for _, each in grouped(rows, "policy", "way", "rate", "quiet")],
        seeds=len({row["seed"] for row in rows}),
        episodes=max((row["episodes"] for row in rows), default=0),
        statics={c: STATIC[c] for c in ("loihi1", "speck2f")},
        errors=errors,
        deviations=deviations,
        rate_text=rate_text,
        summary=summary,
        EQUAL=EQUAL,
        MAP=MAP,
        costs=eye_costs,
    )
    return [page, shown, *(save(each, results / name) for name, each in drawn.items())]
