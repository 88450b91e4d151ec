"""Chips, energy tables, break-even lines and shipped policies: as tables, and as plain data."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import Field, asdict, fields, is_dataclass
from typing import Any

from spikedeploy.reports.table import ABSENT, COMMON_TABLE, Table, format_si
from spikedeploy.runtime.chips.chip import CHIPS, Chip, chip
from spikedeploy.runtime.metrics.energy_tables import STATIC, TABLES, EnergyTable, Uncertainty

_PICO, _NANO = 1e-12, 1e-9
_STEP, _THOUSAND = 0.02, 1_000  # a control step [s], operations
_FACTS = ("what", "found")
_OF_POWERS = ("source", "provenance", "watts", "share", "whole")
_OTHER_FIELDS = ("name", "summary", "evidence", "arithmetic", "sources", "limits")  # no rows of all


# chips


def chip_table(chips: Iterable[Chip]) -> Table:
    """The arithmetic of chips, and what their emulation was compared with."""
    heads = ("name", "neurons", "weights", "membrane", "resets", "readouts", "clocks",
             "compared with")  # fmt: skip
    rows = [
        (
            each.name,
            *each.arithmetic.describe(),
            ", ".join(each.resets),
            "on the host" if each.membrane_output == "none" else each.membrane_output,
            ", ".join(each.clocks),
            each.evidence,
        )
        for each in chips
    ]
    return Table(heads, rows, "What they compute with")


def chip_summaries(chips: Iterable[Chip]) -> Table:
    """List each chip and its energy tables."""
    rows = [(each.name, each.summary, ", ".join(each.energy_tables) or "none") for each in chips]
    return Table(("name", "what it is", "energy tables"), rows, "Chips")


def datasheet(of: Chip) -> Iterator[Table]:
    """Everything about a chip, with the source of every number; fields can be changed by name."""
    neurons, weights, membrane = of.arithmetic.describe()
    facts = [
        ("what it is", of.summary),
        ("neurons", neurons),
        ("weights", weights),
        ("membrane", membrane),
        ("compared with", of.evidence),
        ("energy tables", ", ".join(of.energy_tables) or "none"),
    ]
    heads = ("field", "value", "source")
    yield Table(_FACTS, facts, of.name)
    used = [*_fields(of.arithmetic, of.sources), *_fields(of, of.sources)]
    yield Table(heads, used, "What it computes with")
    if of.limits is not None:
        yield Table(heads, list(_fields(of.limits, of.limits.sources)), "What fits")


def _fields(of: Any, sources: Mapping[str, str]) -> Iterator[tuple[str, str, str]]:  # noqa: ANN401
    every: tuple[Field[Any], ...] = fields(of)
    for name in (field.name for field in every if field.name not in _OTHER_FIELDS):
        value = getattr(of, name)
        if value is not None and value != ():
            yield name, _in_words(value), sources.get(name, "")


def _in_words(value: object) -> str:
    """`24 bits, wrap`, `zero, subtract`, `yes`."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if is_dataclass(value) and not isinstance(value, type):
        named = {key: _in_words(part) for key, part in vars(value).items() if part is not None}
        return ", ".join(f"{key} {part}" for key, part in named.items())
    if isinstance(value, tuple):
        return ", ".join(map(_in_words, value))
    return f"{value:g}" if isinstance(value, float) else str(value)


def chip_list(chips: Iterable[Chip]) -> list[dict[str, Any]]:
    """Chips as plain data, with every field of the datasheets, and sources."""
    known = list(chips)
    table = chip_table(known)
    heads = [head.replace(" ", "_") for head in table.columns]
    return [
        {
            **dict(zip(heads, row, strict=True)),
            "resets": each.resets,
            "clocks": each.clocks,
            "membrane_output": each.membrane_output,
            "summary": each.summary,
            "energy_tables": each.energy_tables,
            "sources": each.sources,
            "fields": {
                field.name: _data(getattr(of, field.name))
                for of in (each.arithmetic, each)
                for field in fields(of)
                if field.name not in _OTHER_FIELDS
            },
            "limits": each.limits and asdict(each.limits),
        }
        for each, row in zip(known, table.rows, strict=True)
    ]


def _data(value: Any) -> Any:  # noqa: ANN401
    return asdict(value) if is_dataclass(value) and not isinstance(value, type) else value


# energy tables


def energy_overview() -> Iterator[Table]:
    """All energy tables, and where their numbers come from."""
    heads = ("table", "chips", "energies [pJ]", "energy is", "times [ns]", "time is")
    yield Table(heads, [_overview_row(table) for table in TABLES.values()], "Energy tables")
    yield static_table()
    yield Table(("table", "source"), _energy_sources(), "Where the numbers come from")


def static_table() -> Table:
    """Idle power of chips, and the rate of operations that takes as much.

    Below that rate the chip's idling decides what it takes. The duty cycle is the share of a
    control step in which a chip that could be switched off between two would have to be on, at a
    thousand synaptic operations one after another.
    """
    heads = ("chip", "idle", "in 20 ms", "SOPs/s that take as much", "by", "duty cycle", "source")
    rows = []
    for name, powers in STATIC.items():
        prices = [TABLES[table] for table in chip(name).energy_tables if table in TABLES]
        table = next((each for each in prices if "sop" in each.joules), TABLES[COMMON_TABLE])
        seconds = table.seconds.get("sop")
        duty = ABSENT if seconds is None else f"{100 * _THOUSAND * seconds / _STEP:.2g} %"
        for power in powers:
            watts = power.watts * power.share
            rate = f"{watts / table.joules['sop']:.2g}"
            own = (f"{format_si(watts)}W", f"{format_si(watts * _STEP)}J", rate, table.name, duty)
            rows.append((name, *own, power.source))
    title = f"Static power, which no other energy has; duty cycle of {_THOUSAND:,} SOPs in 20 ms"
    return Table(heads, rows, title)


def _overview_row(table: EnergyTable) -> tuple[str, ...]:
    energies = {event: f"{joules / _PICO:.4g}" for event, joules in table.joules.items()}
    for event, joules in table.upper_joules.items():
        energies[event] += f" to {joules / _PICO:.4g}"
    times = [f"{event} {seconds / _NANO:.4g}" for event, seconds in table.seconds.items()]
    times.append(f"timestep {table.step / _NANO:,.10g}")
    return (
        table.name,
        ", ".join(_chips_of(table)) or ABSENT,
        ", ".join(f"{event} {price}" for event, price in energies.items()),
        f"{table.certainty}: {table.uncertainty.why}",
        ", ".join(times) if table.timed else ABSENT,
        _time_certainty(table) if table.timed else ABSENT,
    )


def _time_certainty(table: EnergyTable) -> str:
    return f"{table.time_uncertainty.describe()}: {table.time_uncertainty.why}"


def _chips_of(table: EnergyTable) -> list[str]:
    return [name for name in CHIPS if table.name in chip(name).energy_tables]


def _energy_sources() -> list[tuple[str, str]]:
    """Table or static power, and its source."""
    tables = [(table.name, f"{table.source}: {table.provenance}") for table in TABLES.values()]
    powers = [
        (p.name, f"static, {name}: {p.watts * 1e3:g} mW, {p.whole}. {p.source}: {p.provenance}")
        for name, powers in STATIC.items()
        for p in powers
    ]
    return [*tables, *powers]


def energy_choice() -> str:
    """The table to quote."""
    return (
        f"Quote {COMMON_TABLE} where spiking and float networks are compared: it prices both, with "
        "sums in registers; of pruned ones quote those with sums in memory (acc16, acc32) beside "
        "it. A chip's own tables are for that chip alone; say which."
    )


def energy_sheet(table: EnergyTable) -> Iterator[Table]:
    """Sources of a table's numbers, their certainty, and all prices and times."""
    facts = [
        ("chips", ", ".join(_chips_of(table)) or "none"),
        ("source", table.source),
        ("provenance", table.provenance),
        ("energy is", f"{table.certainty}: {table.uncertainty.why}"),
    ]
    if table.timed:
        facts.append(("time is", _time_certainty(table)))
        facts.append(("a timestep", f"{format_si(table.step)}s"))
    if table.included:
        facts.append(("included in others", ", ".join(table.included)))
    yield Table(_FACTS, facts, table.name)
    prices = [
        (name, _pico(table.joules.get(name)), _pico(table.upper_joules.get(name)),
         _nano(table.seconds.get(name)))
        for name in dict.fromkeys([*table.joules, *table.seconds])
    ]  # fmt: skip
    yield Table(("event", "energy", "at most", "time"), prices, "Events", numbers=True)


def _pico(joules: float | None) -> str:
    return ABSENT if joules is None else f"{1e12 * joules:.4g} pJ"


def _nano(seconds: float | None) -> str:
    return ABSENT if seconds is None else f"{1e9 * seconds:.4g} ns"


def price_list() -> dict[str, list[dict[str, Any]]]:
    """Tables and static powers as plain data."""
    return {
        "tables": [
            {
                "name": table.name,
                "chips": _chips_of(table),
                "source": table.source,
                "provenance": table.provenance,
                "joules": dict(table.joules),
                "most_joules": dict(table.upper_joules),
                "included": list(table.included),
                "uncertainty": _uncertain(table.uncertainty),
                "seconds": dict(table.seconds),
                "step_seconds": table.step,
                "time_uncertainty": _uncertain(table.time_uncertainty) if table.timed else None,
            }
            for table in TABLES.values()
        ],
        "static": [
            {
                "name": power.name,
                "chip": name,
                **{key: getattr(power, key) for key in _OF_POWERS},
            }
            for name, powers in STATIC.items()
            for power in powers
        ],
    }


def _uncertain(uncertainty: Uncertainty) -> dict[str, Any]:
    return {
        "low": uncertainty.low,
        "high": uncertainty.high,
        "is": uncertainty.describe(),
        "why": uncertainty.why,
    }


# policies


def policy_facts(name: str, card: Mapping[str, Any]) -> Table:
    """The origin of a shipped policy, by its card."""
    policy = card.get("config", {}).get("policy", {})
    facts = {
        "name": name,
        **{key: card.get(key) for key in ("file", "kind", "env", "recipe", "seed", "steps")},
        "network": ", ".join(
            f"{key} {_sizes(value)}" for key, value in policy.items() if value is not None
        ),
        "created": card.get("created"),
        "note": card.get("note"),
    }
    rows = [(key, str(value)) for key, value in facts.items() if value not in (None, "")]
    return Table(_FACTS, rows, "Policy")


def _sizes(value: object) -> str:
    return " × ".join(map(str, value)) if isinstance(value, list) else str(value)
