"""The report of `check`: which chips a network fits on, and what it takes of their cores."""

import re
from collections.abc import Sequence
from typing import Any

from spikedeploy.console import print_text
from spikedeploy.emulation.design_report import DesignReport
from spikedeploy.reports.page import provenance, render
from spikedeploy.reports.table import ABSENT, Table
from spikedeploy.runtime.chips.chip import Limits
from spikedeploy.runtime.compiler.compile import COMPILE, DesignCheck
from spikedeploy.runtime.compiler.mapping import (
    Placement,
    Shares,
    mapping_utilisation,
    placement_utilisation,
)
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.compiler.rules import RuleResult, format_value
from spikedeploy.runtime.families.integrate_and_fire.arithmetic import IN_TIMESTEPS

LEGEND = "✓ keeps the rule   ✗ breaks it   ? no limit is published   · not applicable"
_MARKS = {"pass": "✓", "fail": "✗", "unknown": "?", "not applicable": "·"}
_CHIPS_PER_TABLE = 8  # on the terminal


def print_report(report: DesignReport, everything: bool = True) -> None:
    """Print the verdicts and the broken rules; with `everything` all rules too."""
    print_text(f"{report.file}: {report.artifact.convention.describe()}\n")
    alone = len(report.checks) == 1
    if everything and alone:
        _print_chip(report.checks[0])
    elif everything:
        for first in range(0, len(report.checks), _CHIPS_PER_TABLE):
            _rules_by_chip(report.checks[first : first + _CHIPS_PER_TABLE], "-\n").print()
        print(LEGEND)
    if alone:
        for line in _broken_rules(report.checks[0]):
            print(f"✗ {line}")
    for each in report.checks:
        _, typed = report.resets.get(each.chip.name, ("", ""))
        fits = f". With {typed}: fits, as another network" if typed else ""
        mark = _MARKS["pass" if each.passed else "fail"]
        print(f"{mark} {each.chip.name}: {_summary(each)}{fits}")
    if not (everything and alone):  # which prints all notes
        _print_remarks(report)
    if not everything:
        print("All rules: --rules" + "; why a chip cannot: --chip NAME" * (not alone))


def _print_remarks(report: DesignReport) -> None:
    """Print what is said of coarse layers and of timesteps, with the chips where so."""
    chips: dict[str, list[str]] = {}
    for each in report.checks:
        for remark in _remarks(each.program) if each.program else ():
            chips.setdefault(remark, []).append(each.chip.name)
    for remark, names in chips.items():
        print_text(remark if len(report.checks) == 1 else f"{', '.join(names)}: {remark}")


def _remarks(program: Program) -> list[str]:
    """The remarks that a verdict does not go without."""
    return [each for each in program.remarks if each in (*program.outliers, IN_TIMESTEPS)]


def _print_chip(check: DesignCheck) -> None:
    if check.chip.limits is not None:
        _layers(check, check.chip.limits).print()
    _rules(check).print()
    print(LEGEND)
    for note in _notes(check):
        print(f"  {note}")


def _summary(check: DesignCheck) -> str:
    """The names of the broken rules; or cores and clock."""
    if not check.passed:
        return f"breaks {', '.join(_broken(check))}"
    clock = f", clock {check.program.describe_clock()}" if check.program else ""
    if check.chip.limits is None:
        return f"no limits{clock}"
    return (f"{check.mapping.cores} cores" if check.mapping.cores else "fits") + clock


def _broken(check: DesignCheck) -> dict[str, RuleResult]:
    """Broken rule -> its worst result; the compiler's counts for the rule that it names."""
    broken = {rule: result for rule, result in check.worst.items() if result.failed}
    if (compiler := broken.pop(COMPILE, None)) is not None:
        named = re.match(r"rule ([\w-]+):", str(compiler.found))
        broken.setdefault(named[1] if named else COMPILE, compiler)
    return broken


def _broken_rules(check: DesignCheck) -> list[str]:
    return [result.describe(check.chip.name) for result in _broken(check).values()]


def _notes(check: DesignCheck) -> list[str]:
    return [f"{rule}: {r.note}" for rule, r in check.worst.items() if r.note and not r.failed]


# tables


def _rules_by_chip(checks: Sequence[DesignCheck], dash: str = "-") -> Table:
    """Every rule, and its status on each chip.

    dash: in the names of chips; with a line break names are narrow
    """
    columns = [each.worst for each in checks]
    rows = [(rule, *(_MARKS[column[rule].status] for column in columns)) for rule in columns[0]]
    return Table(("rule", *(each.chip.name.replace("-", dash) for each in checks)), rows, "Rules")


def _rules(check: DesignCheck) -> Table:
    rows = [_rule(check, rule) for rule in check.worst]
    return Table(("rule", "", "found", "limit", "node"), rows, f"Rules of {check.chip.name}")


def _rule(check: DesignCheck, rule: str) -> tuple[str, ...]:
    result, results = check.worst[rule], check.results_of(rule)
    found = "" if result.found is None else f"{format_value(result.found)} {result.unit}".rstrip()
    node = "" if result.status == "not applicable" else result.node or ""
    if result.status == "pass" and result.node and isinstance(result.found, str):
        passed = [each for each in results if each.status == "pass"]
        found = ", ".join(sorted({format_value(each.found) for each in passed}))
        node = f"{len(passed)} nodes"
    limit = "" if result.limit is None else format_value(result.limit)
    return rule, _MARKS[result.status], found, limit, node


def _layers(check: DesignCheck, limits: Limits) -> Table:
    """Every layer: its sizes, its cores, and what it takes of the fullest one."""
    placements, cores = check.mapping.placements, check.mapping.cores
    rows = [_layer(placement, limits) for placement in placements]
    if cores:
        neurons, synapses = (
            sum(getattr(p, k) for p in placements) for k in ("neurons", "synapses")
        )
        shares = mapping_utilisation(placements, limits)
        total = (f"{neurons:,}", "", "", f"{synapses:,}", f"{cores:,}", "")
        rows.append(("total", *total, *_percent(shares)))
    heads = ("layer", "neurons", "fan-in", "fan-out", "synapses", "cores", "per core")
    title = f"Layers on {check.chip.name}; per core and shares: the fullest core"
    return Table((*heads, "neurons", "memory", "axons in", "axons out"), rows, title, numbers=True)


def _layer(placement: Placement, limits: Limits) -> tuple[str, ...]:
    counts = (placement.neurons, placement.fan_in, placement.fan_out, placement.synapses)
    cores = (_cores(placement), f"{placement.block:,}") if placement.cores else (ABSENT, ABSENT)
    shares = _percent(placement_utilisation(placement, limits))
    return placement.name, *(f"{count:,}" for count in counts), *cores, *shares


def _cores(placement: Placement) -> str:
    if placement.first is None:
        return f"{placement.cores:,}"
    last = placement.first + placement.cores - 1
    which = f"{placement.first}" if placement.cores == 1 else f"{placement.first}–{last}"
    return f"{placement.cores:,} ({which})"


def _percent(shares: Shares) -> list[str]:
    return [ABSENT if share is None else f"{share:.1%}" for share in shares.values()]


# the page


def design_page(report: DesignReport) -> str:
    """The page as one file."""
    checks = report.checks
    alone = len(checks) == 1
    return render(
        "design",
        title=f"{report.file}: design rules" + (f" of {checks[0].chip.name}" if alone else ""),
        lead=_lead(checks),
        chips=None if alone else _chips(checks),
        rules_by_chip=_rules_by_chip(checks),
        checks=[_check(each) for each in checks],
        legend=LEGEND,
        made=[
            ("convention", report.artifact.convention.describe()),
            *([("tuned", tuned)] if (tuned := report.artifact.tuned) else []),
            *provenance(),
        ],
    )


def _lead(checks: Sequence[DesignCheck]) -> str:
    if len(checks) == 1:
        (check,) = checks
        verb = "It fits on" if check.passed else "It does not fit on"
        return f"{verb} {check.chip.name}: {_summary(check)}."
    limited = [each for each in checks if each.chip.limits is not None]
    fits = [each.chip.name for each in limited if each.passed]
    return f"It keeps all rules of {', '.join(fits) or 'no chip'}; {len(limited)} have limits."


def _chips(checks: Sequence[DesignCheck]) -> Table:
    rows = []
    for each in checks:
        cores = f"{each.mapping.cores:,}" if each.mapping.cores else ABSENT
        no_limits = "no limits" if each.chip.limits is None else ""
        broken = no_limits if each.passed else ", ".join(_broken(each))
        rows.append((each.chip.name, "fits" if each.passed else "does not fit", cores, broken))
    kinds = ["pass" if each.passed else "fail" for each in checks]
    return Table(("chip", "verdict", "cores", "broken rules"), rows, kinds=kinds)


def _check(check: DesignCheck) -> dict[str, Any]:
    limits = check.chip.limits
    return {
        "chip": check.chip.name,
        "summary": _summary(check),
        "broken": _broken_rules(check),
        "layers": limits and _layers(check, limits),
        "rules": _rules(check),
        "notes": _notes(check),
    }
