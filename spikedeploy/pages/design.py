"""The page of a design report: which chips a network fits on, and what it takes of their cores."""

from collections.abc import Iterator, Sequence

from spikedeploy.emulation.design_report import DesignReport
from spikedeploy.pages.cores import cores_svg, legend
from spikedeploy.pages.page import (
    big_numbers,
    facts,
    figure,
    folded,
    heading,
    hint,
    page,
    said,
    table,
)
from spikedeploy.pages.written import made_by
from spikedeploy.reports.cells import ABSENT
from spikedeploy.reports.check_tables import LEGEND, broken, layers, notes, rules, rules_by_chip
from spikedeploy.reports.check_tables import summary as in_words
from spikedeploy.reports.headline import HeadlineNumber
from spikedeploy.runtime.compiler.compile import DesignCheck

_CAPTION = (
    "A square is a core: at the left its neurons, at the right its synaptic memory, as far as they "
    "are taken. The memory is that of the fullest core of each layer."
)


def design_page(report: DesignReport) -> str:
    """The page as one file."""
    alone = len(report.checks) == 1
    return page(
        f"{report.file}: design rules" + (f" of {report.checks[0].chip.name}" if alone else ""),
        _lead(report.checks),
        [
            big_numbers(_numbers(report.checks)),
            *(_chip(report.checks[0]) if alone else _chips(report.checks)),
            folded("How this was checked", facts(_made(report))),
        ],
    )


def _lead(checks: Sequence[DesignCheck]) -> str:
    limited = [each for each in checks if each.chip.limits is not None]
    if len(checks) == 1:
        (found,) = checks
        verb = "It fits on" if found.passed else "It does not fit on"
        return f"{verb} {found.chip.name}: {in_words(found, alone=True)}."
    fits = [each.chip.name for each in limited if each.passed]
    return f"It keeps all rules of {', '.join(fits) or 'no chip'}; {len(limited)} have limits."


def _numbers(checks: Sequence[DesignCheck]) -> Iterator[HeadlineNumber]:
    found = checks[0]
    if len(checks) == 1:
        rule = broken(found)
        kept = f"{len(rule)} broken rules" if rule else "every rule is kept"
        yield HeadlineNumber("verdict", "fits" if found.passed else "does not fit", (kept,))
    else:
        limited = [each for each in checks if each.chip.limits is not None]
        fits, of = sum(each.passed for each in limited), f"of {len(limited)} that have limits"
        yield HeadlineNumber("chips that it fits on", str(fits), (of,))
    neurons = [each for each in found.mapping.placements if each.kind == "neurons"]
    synapses, fan_in = sum(e.synapses for e in neurons), max((e.fan_in for e in neurons), default=0)
    count = f"{sum(each.neurons for each in neurons):,}"
    beside = f"in {len(neurons)} population{'s' if len(neurons) > 1 else ''}, {synapses:,} synapses"
    yield HeadlineNumber("neurons", count, (beside,))
    if len(checks) > 1:
        yield HeadlineNumber("synapses", f"{synapses:,}", (f"{fan_in:,} at most onto a neuron",))
    if len(checks) == 1 and found.mapping.cores:
        chips = found.mapping.chips
        where = f"on {chips} chip{'s' if chips > 1 else ''}" if chips else ""
        yield HeadlineNumber("cores", f"{found.mapping.cores:,}", (where,) if where else ())


def _chips(checks: Sequence[DesignCheck]) -> Iterator[str]:
    """A line for each chip, the rules of all, then each chip under a line that opens it."""
    yield heading("All chips")
    rows = [
        (each.chip.name, "fits" if each.passed else "does not fit", _cores(each), _why(each))
        for each in checks
    ]
    kinds = ["pass" if each.passed else "fail" for each in checks]
    yield table(("chip", "verdict", "cores", "broken rules"), rows, kinds)
    yield folded("All rules", table(*rules_by_chip(checks)) + hint(LEGEND))
    for each in checks:
        yield folded(f"{each.chip.name}: {in_words(each, alone=True)}", "".join(_chip(each)))


def _cores(found: DesignCheck) -> str:
    return f"{found.mapping.cores:,}" if found.mapping.cores else ABSENT


def _why(found: DesignCheck) -> str:
    """The names of the rules that it breaks."""
    if found.passed:
        return "no limits" if found.chip.limits is None else ""
    return ", ".join(dict.fromkeys(each.rule for each in found.rulings if each.failed))


def _chip(found: DesignCheck) -> Iterator[str]:
    """What is broken, the cores, the layers, the rules."""
    yield said(*broken(found))
    limits = found.chip.limits
    if limits is not None:
        if drawn := cores_svg(found.mapping, limits, found.chip.name):
            yield heading(f"Cores of {found.chip.name}")
            yield figure(drawn + legend(found.mapping), _CAPTION)
        yield heading("Layers")
        yield table(*layers(found, limits)) + hint("Per core, and shares: of the fullest core.")
    yield heading("Rules")
    yield table(*rules(found)) + hint(LEGEND)
    yield said(*notes(found))


def _made(report: DesignReport) -> list[tuple[str, str]]:
    return [("convention", report.artifact.convention.describe()), *made_by()]
