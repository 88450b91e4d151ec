"""The tables of a design report: rules by chip, or layers and rules of one chip."""

from collections.abc import Sequence

from spikedeploy.console import print_table, print_text
from spikedeploy.emulation.design_report import DesignReport, statuses, worst
from spikedeploy.runtime.chips.limits import Limits
from spikedeploy.runtime.compiler.compile import DesignCheck
from spikedeploy.runtime.design_rules.mapping import Placement, of_mapping, of_placement
from spikedeploy.runtime.design_rules.rule import RuleResult, text

_MARKS = {"pass": "✓", "fail": "✗", "unknown": "?", "not applicable": "·"}
_LEGEND = "✓ keeps the rule   ✗ breaks it   ? no limit is published   · not applicable"
# chips side by side in a table
_PER_TABLE = 8


def print_report(report: DesignReport, rules: bool = True) -> None:
    """Print the verdicts and the broken rules; with `rules` the tables of all rules too."""
    print_text(f"{report.file}: {report.artifact.convention.describe()}\n")
    alone = len(report.checks) == 1
    if rules and alone:
        _print_chip(report.checks[0])
    elif rules:
        _print_chips(report.checks)
    if alone:
        _print_broken(report.checks[0])
    for each in report.checks:
        mark = _MARKS["pass" if each.passed else "fail"]
        print(f"{mark} {each.chip.name}: {_summary(each, alone)}")
    if not rules:
        print("All rules: --rules")


def _print_chips(checks: Sequence[DesignCheck]) -> None:
    for first in range(0, len(checks), _PER_TABLE):
        part = checks[first : first + _PER_TABLE]
        columns = [statuses(each) for each in part]
        rows = [(rule, *(_MARKS[column[rule]] for column in columns)) for rule in columns[0]]
        heads = [each.chip.name.replace("-", "-\n") for each in part]
        print_table("Rules", ("rule", *heads), rows)
    print(_LEGEND)


def _print_broken(found: DesignCheck) -> None:
    """Print a line for each broken rule."""
    for ruling in _broken(found):
        print(f"✗ {ruling.describe(found.chip.name)}")


def _broken(found: DesignCheck) -> list[RuleResult]:
    """The worst result of each broken rule."""
    worsts = [worst(found.of(rule)) for rule in statuses(found)]
    return [ruling for ruling in worsts if ruling.failed]


def _summary(found: DesignCheck, alone: bool) -> str:
    """The broken rules, and the first in full unless it stands above; or the number of cores."""
    if not found.passed:
        first = next(ruling for ruling in found.rulings if ruling.failed)
        rules = list(dict.fromkeys(ruling.rule for ruling in found.rulings if ruling.failed))
        told = "" if alone else f". First {first.describe(found.chip.name)}"
        return f"breaks {', '.join(rules)}{told}"
    if found.chip.limits is None:
        return "no limits"
    return f"{found.mapping.cores} cores" if found.mapping.cores else "fits"


def _print_chip(found: DesignCheck) -> None:
    limits = found.chip.limits
    if limits is not None:
        _print_layers(found, limits)
    rows = [_rule(found, rule) for rule in statuses(found)]
    print_table(f"Rules of {found.chip.name}", ("rule", "", "found", "limit", "node"), rows)
    print(_LEGEND)
    for rule in statuses(found):
        ruling = worst(found.of(rule))
        if ruling.note and not ruling.failed:
            print(f"  {rule}: {ruling.note}")


def _print_layers(found: DesignCheck, limits: Limits) -> None:
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
    title = f"Layers on {found.chip.name}; per core and shares: the fullest core"
    print_table(title, (*heads, *used), rows, numbers=True)


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
