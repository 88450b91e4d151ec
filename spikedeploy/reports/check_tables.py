"""The tables of a design report: rules by chip, or layers and rules of one chip."""

from collections.abc import Sequence
from typing import TypeAlias

from spikedeploy.console import print_table, print_text
from spikedeploy.emulation.design_report import DesignReport, statuses, worst
from spikedeploy.runtime.chips.limits import Limits
from spikedeploy.runtime.compiler.compile import DesignCheck
from spikedeploy.runtime.design_rules.mapping import Placement, of_mapping, of_placement
from spikedeploy.runtime.design_rules.rule import RuleResult, text

# heads, and rows of cells
Cells: TypeAlias = tuple[Sequence[str], list[tuple[str, ...]]]
_MARKS = {"pass": "✓", "fail": "✗", "unknown": "?", "not applicable": "·"}
LEGEND = "✓ keeps the rule   ✗ breaks it   ? no limit is published   · not applicable"
# chips side by side in a table
_PER_TABLE = 8


def print_report(report: DesignReport, everything: bool = True) -> None:
    """Print the verdicts and the broken rules; with `everything` all rules too."""
    print_text(f"{report.file}: {report.artifact.convention.describe()}\n")
    alone = len(report.checks) == 1
    if everything and alone:
        _print_chip(report.checks[0])
    elif everything:
        _print_chips(report.checks)
    if alone:
        for line in broken(report.checks[0]):
            print(f"✗ {line}")
    for each in report.checks:
        mark = _MARKS["pass" if each.passed else "fail"]
        print(f"{mark} {each.chip.name}: {summary(each, alone)}{_remedy(report, each, alone)}")
    if not everything:
        print("All rules: --rules")


def _print_chips(checks: Sequence[DesignCheck]) -> None:
    for first in range(0, len(checks), _PER_TABLE):
        part = checks[first : first + _PER_TABLE]
        print_table("Rules", *rules_by_chip(part, "-\n"))
    print(LEGEND)


def rules_by_chip(checks: Sequence[DesignCheck], dash: str = "-") -> Cells:
    """Every rule, and its status on each chip.

    dash  in the names of chips; with a line break names are narrow
    """
    columns = [statuses(each) for each in checks]
    rows = [(rule, *(_MARKS[column[rule]] for column in columns)) for rule in columns[0]]
    return ("rule", *(each.chip.name.replace("-", dash) for each in checks)), rows


def broken(found: DesignCheck) -> list[str]:
    """A line for each broken rule, of its worst result."""
    worsts = [worst(found.of(rule)) for rule in statuses(found)]
    return [ruling.describe(found.chip.name) for ruling in worsts if ruling.failed]


def _remedy(report: DesignReport, found: DesignCheck, alone: bool) -> str:
    """The reset with which the network would fit, where that is all that it lacks."""
    reset = report.resets.get(found.chip.name)
    return "" if reset is None else f"{'.' * alone} With --reset {reset}: fits."


def summary(found: DesignCheck, alone: bool) -> str:
    """The broken rules, and the first in full unless it stands above; or cores and clock."""
    if not found.passed:
        first = next(ruling for ruling in found.rulings if ruling.failed)
        names = list(dict.fromkeys(ruling.rule for ruling in found.rulings if ruling.failed))
        told = "" if alone else f". First {first.describe(found.chip.name)}"
        return f"breaks {', '.join(names)}{told}"
    clock = f", clock {found.program.describe_clock()}" if found.program else ""
    if found.chip.limits is None:
        return f"no limits{clock}"
    return (f"{found.mapping.cores} cores" if found.mapping.cores else "fits") + clock


def _print_chip(found: DesignCheck) -> None:
    limits = found.chip.limits
    if limits is not None:
        title = f"Layers on {found.chip.name}; per core and shares: the fullest core"
        print_table(title, *layers(found, limits), numbers=True)
    print_table(f"Rules of {found.chip.name}", *rules(found))
    print(LEGEND)
    for note in notes(found):
        print(f"  {note}")


def rules(found: DesignCheck) -> Cells:
    """Every rule of a chip: its status, what was found, the limit, where."""
    rows = [_rule(found, rule) for rule in statuses(found)]
    return ("rule", "", "found", "limit", "node"), rows


def notes(found: DesignCheck) -> list[str]:
    """What a reader must know to judge rules that are kept."""
    worsts = {rule: worst(found.of(rule)) for rule in statuses(found)}
    return [
        f"{rule}: {each.note}" for rule, each in worsts.items() if each.note and not each.failed
    ]


def layers(found: DesignCheck, limits: Limits) -> Cells:
    """Every layer: its sizes, its cores, and what it takes of the fullest one."""
    heads = ("layer", "neurons", "fan-in", "fan-out", "synapses", "cores", "per core")
    used = ("neurons", "memory", "axons in", "axons out")
    rows = [_layer(placement, limits) for placement in found.mapping.placements]
    if found.mapping.cores:
        shares = of_mapping(found.mapping, limits)
        whole = (shares.neurons, shares.memory, shares.axons_in, shares.axons_out)
        synapses = sum(placement.synapses for placement in found.mapping.placements)
        neurons = sum(placement.neurons for placement in found.mapping.placements)
        total = (f"{neurons:,}", "", "", f"{synapses:,}", f"{found.mapping.cores:,}", "")
        rows.append(("total", *total, *map(_percent, whole)))
    return (*heads, *used), rows


def _layer(placement: Placement, limits: Limits) -> tuple[str, ...]:
    counts = (placement.neurons, placement.fan_in, placement.fan_out, placement.synapses)
    shares = of_placement(placement, limits)
    each = (shares.neurons, shares.memory, shares.axons_in, shares.axons_out)
    cores = (_numbers(placement), f"{placement.block:,}") if placement.cores else ("–", "–")
    return placement.name, *(f"{count:,}" for count in counts), *cores, *map(_percent, each)


def _numbers(placement: Placement) -> str:
    """The number of cores, and their indices."""
    if placement.first is None:
        return f"{placement.cores:,}"
    last = placement.first + placement.cores - 1
    which = f"{placement.first}" if placement.cores == 1 else f"{placement.first}–{last}"
    return f"{placement.cores:,} ({which})"


def _percent(share: float | None) -> str:
    return "–" if share is None else f"{share:.1%}"


def _rule(found: DesignCheck, rule: str) -> tuple[str, ...]:
    rulings = found.of(rule)
    ruling = worst(rulings)
    mark = _MARKS[ruling.status]
    node = "" if ruling.status == "not applicable" else ruling.node or ""
    if ruling.status == "pass" and ruling.node and isinstance(ruling.found, str):
        same = {each.found for each in rulings if each.status == "pass"}
        node = f"{sum(each.status == 'pass' for each in rulings)} nodes"
        return rule, mark, ", ".join(sorted(map(text, same))), text(ruling.limit), node
    return rule, mark, _found(ruling), "" if ruling.limit is None else text(ruling.limit), node


def _found(ruling: RuleResult) -> str:
    if ruling.found is None:
        return ""
    return f"{text(ruling.found)} {ruling.unit}".rstrip()
