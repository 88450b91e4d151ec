"""Tables and sentences of the pareto page."""

import math
from collections.abc import Sequence

from lab.experiments.pareto.costs import ACC16, ACC32, INT8, TERMS, TOTALS
from lab.experiments.pareto.design import LABELS, LAST
from lab.experiments.pareto.fronts import (
    Pairing,
    Point,
    Record,
    pairing,
    pairing_at,
    points,
    refusals,
    span_at,
)
from spikedeploy.comparison.statistics import Estimate
from spikedeploy.reports.table import ABSENT, markdown_text

# shares of the teacher's score: points below the second are of no use, and not compared
NEARLY, NEAR = 0.98, 0.95
Span = tuple[float | None, float | None]
_PICO = 1e12
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


def number(value: float | None, form: str = ",.0f") -> str:
    """A number, or a dash where there is none."""
    return ABSENT if value is None else format(value, form)


def pico(joules: float) -> str:
    """An energy in pJ."""
    return format(joules * _PICO, ",.0f")


def of_teacher(point: Point) -> str:
    """`99.5% [99.2%, 99.8%]`."""
    return share(point.of_teacher)


def share(score: Estimate | None) -> str:
    """With the interval; a dash where there is no reference, or it scores nothing."""
    if score is None or math.isnan(score.mean):
        return ABSENT
    low, high = score.ci95
    return f"{score.mean:.1%}" + ("" if math.isnan(low) else f" [{low:.1%}, {high:.1%}]")


def mean_of_teacher(point: Point) -> str:
    """Without the interval; a dash where the teacher scores nothing."""
    mean = point.of_teacher.mean
    return ABSENT if math.isnan(mean) else f"{mean:.1%}"


def energy_table(found: Sequence[Point]) -> str:
    """Energies of every level, total by total."""
    heads = ["policy", "aim", "% of teacher", "operations alone", "+ neuron updates", "+ the rest"]
    lean = ["+ lean updates", "lean, + the rest"]
    sums = [f"{head}, {words}" for words in _SUMS.values() for head in ("operations", "all")]
    lines = [[*heads, *lean, *sums, "davies2018", "sanafe"]]
    for p in found:
        cells = [p.label, f"{p.level:g}", mean_of_teacher(p)]
        cells += [pico(p.energy(of)) for of in TOTALS]
        cells += [pico(p.energy(of, lean=True)) for of in ("updates", "all")]
        cells += [pico(p.energy(of, table)) for table in _SUMS for of in ("operations", "all")]
        if p.spiking:
            cells += [pico(p.energy("all", table)) for table in ("davies2018", "sanafe")]
        else:
            cells += [ABSENT, ABSENT]
        lines.append(cells)
    return markdown_text(lines)


def term_table(found: Sequence[Point]) -> str:
    """Energy of each term of the last level of each student, by imitation and with reward."""
    lines = [["policy", "aim", *TERMS, "lean updates"]]
    for p in last_levels(found):
        cells = [pico(joules) for joules in p.terms().values()]
        lean = pico(p.terms(lean=True)["updates"])
        lines.append([p.label, f"{p.level:g}", *cells, lean])
    return markdown_text(lines)


def last_levels(found: Sequence[Point]) -> list[Point]:
    """The last level of each student, by imitation and with reward."""
    return list({(p.student, p.rewarded): p for p in found}.values())


def baseline_table(found: Sequence[Point]) -> str:
    """Every spiking point near the teacher beside its cheapest float baseline."""
    lines = [["policy", "aim", "% of teacher", *(w.lower() for w in _WORDS.values()), "lean, all"]]
    for point in found:
        if point.spiking and point.of_teacher.mean >= NEAR:
            pairs = [pairing(found, point, of) for of in TOTALS]
            pairs.append(pairing(found, point, "all", lean=True))
            cells = [point.label, f"{point.level:g}", mean_of_teacher(point)]
            lines.append([*cells, *map(_against, pairs)])
    return markdown_text(lines) if len(lines) > 1 else ""


def _against(pair: Pairing) -> str:
    if pair.baseline is None or pair.ratio is None:
        return "no float student is as good"
    mine, theirs = pair.energies
    label = f"{pair.baseline.label} {pair.baseline.level:g}"
    return f"{pico(mine)} : {pico(theirs or 0.0)} = {pair.ratio:.2f} ({label})"


def sentences(found: Sequence[Point]) -> list[str]:
    """For each total the cheapest spiking and float points that are good, and what decides."""
    lines = []
    for of, words in _WORDS.items():
        lines.append(_sentence(found, of, words, lean=False))
    words = "The same with 16-bit states and power-of-two decays (derived)"
    lines.append(_sentence(found, "all", words, lean=True))
    in_memory = [
        _sentence(found, of, f"{_WORDS[of]}, {sums}", lean=False, table=table)
        for table, sums in _SUMS.items()
        for of in ("operations", "all")
    ]
    return [*lines, *in_memory]


def _sentence(found: Sequence[Point], of: str, words: str, lean: bool, table: str = INT8) -> str:
    pairs = {share: pairing_at(found, share, of, lean, table) for share in (NEARLY, NEAR)}
    known = [pair for pair in pairs.values() if pair is not None and pair.ratio is not None]
    if not known:
        return f"- {words}: {_lack(found)}, so there is nothing to compare."
    spans = {share: span_at(found, share, of, lean, table) for share in pairs}
    parts = [
        f"for {share:.0%} of the teacher's score {_beside(pair, spans[share])}"
        for share, pair in pairs.items()
    ]
    marks = {_mark(pair, spans[share]) for share, pair in pairs.items() if pair in known}
    mark = marks.pop() if len(marks) == 1 else "≈"
    text = f"- {mark} {words}: {'; '.join(parts)}."
    return text if of == "operations" else f"{text} {_decides(known[0])}."


def _mark(pair: Pairing, span: Span) -> str:
    """✓ where the spiking point is cheaper wherever in its interval a score is, ✗ never; or ≈."""
    least, largest = span
    if largest is not None and largest <= 1:
        return "✓"
    return "✗" if ((pair.ratio if least is None else least) or 0.0) > 1 else "≈"


def _beside(pair: Pairing | None, span: Span) -> str:
    """What a spiking point costs beside its baseline, as the means and as the intervals have it."""
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


def _decides(pair: Pairing) -> str:
    """Which term is most of a spiking point's energy."""
    terms = pair.point.terms(pair.lean, pair.table).items()
    mine = {name: joules for name, joules in terms if name in TOTALS[pair.of]}
    most = max(mine, key=lambda name: mine[name])
    part = mine[most] / sum(mine.values())
    return f"{part:.0%} of the first is for {_TERM_WORDS[most]}{_lever(pair, most)}"


def _lack(found: Sequence[Point]) -> str:
    """Why nothing can be compared."""
    if not any(p.spiking and p.of_teacher.mean >= NEAR for p in found):
        return f"no spiking policy reaches {NEAR:.0%} of the teacher"
    if all(p.spiking for p in found):
        return "no float student is evaluated yet"
    return "no float student reaches the return of a spiking one"


def _lever(pair: Pairing, most: str) -> str:
    """What would have to be cheaper for a losing point to draw level."""
    if pair.ratio is None or pair.baseline is None or pair.ratio <= 1:
        return ""
    terms = pair.point.terms(pair.lean, pair.table)
    mine, theirs = pair.energies
    over = mine - (theirs or 0.0)
    left = terms[most] - over
    if left <= 0:
        return "; without that it would still cost more"
    return f"; it would draw level if that cost {left / terms[most]:.2f} times as much"


def _named(point: Point) -> str:
    return f"{point.label} at {point.level:g} ({point.of_teacher.mean:.1%})"


def place_table(rows: Sequence[Record], found: Sequence[Point]) -> str:
    """The last level of each student on other chips and in fewer bits."""
    here = points(rows, LAST)
    refused = refusals(rows)
    last = last_levels(found)
    levels = [_first_episodes(p, here) for p in last]
    lines = [["policy", "aim", "where", "% of teacher", "operations", "saturations"]]
    order = [p.student for p in last]
    for p in sorted([*levels, *here], key=lambda p: order.index(p.student)):
        cells = [p.label, f"{p.level:g}", p.place, of_teacher(p)]
        more = " + readouts on the host" if p.mean("on_host") else ""
        counts = [number(p.mean("operations"), ",.1f") + more, number(p.mean("saturations"))]
        lines.append([*cells, *counts])
    for (student, place), why in refused.items():
        lines.append([LABELS[student], ABSENT, place, f"refused: {why}", ABSENT, ABSENT])
    return markdown_text(lines)


def _first_episodes(point: Point, others: Sequence[Point]) -> Point:
    """A point on the episodes alone that others were evaluated on; its counts are of all."""
    count = min((len(p.teacher) for p in others), default=len(point.teacher))
    rows = [{**row, "scores": row["scores"][:count]} for row in point.rows]
    return Point(point.student, point.level, point.place, rows, point.teacher[:count])
