"""One chip, one energy table or one shipped policy in full, as rows of tables."""

from collections.abc import Iterator, Mapping
from dataclasses import Field, asdict, fields, is_dataclass
from typing import Any

from spikedeploy.reports.cells import scaled
from spikedeploy.runtime.chips.chip import Chip
from spikedeploy.runtime.metrics.energy import EnergyTable, describe_certainty

CHIP_FIELDS = ("field", "value", "source")
EVENT_COLUMNS = ("event", "energy", "at most", "time")
_SAID = ("name", "summary", "evidence", "arithmetic", "sources", "limits")  # elsewhere, or not rows


def chip_facts(chip: Chip) -> list[tuple[str, str]]:
    """What a chip is, and what its emulation was compared with."""
    neurons, weights, membrane = chip.arithmetic.describe()
    return [
        ("what it is", chip.summary),
        ("neurons", neurons),
        ("weights", weights),
        ("membrane", membrane),
        ("compared with", chip.evidence),
        ("energy tables", ", ".join(chip.energy_tables) or "none"),
    ]


def chip_fields(chip: Chip) -> list[tuple[str, str, str]]:
    """Every field of a chip and its arithmetic, with its source; they can be changed by name."""
    return [*_rows(chip.arithmetic, chip.sources), *_rows(chip, chip.sources)]


def chip_limits(chip: Chip) -> list[tuple[str, str, str]]:
    """Every limit that is published, with its source."""
    limits = chip.limits
    return [] if limits is None else list(_rows(limits, limits.sources))


def chip_json(chip: Chip) -> dict[str, Any]:
    """Every field of the chip and of its arithmetic, and its limits, as plain data."""
    found = {
        field.name: getattr(of, field.name)
        for of in (chip.arithmetic, chip)
        for field in fields(of)
        if field.name not in _SAID
    }
    data = {name: _data(value) for name, value in found.items()}
    return {"fields": data, "limits": chip.limits and asdict(chip.limits)}


def _data(value: Any) -> Any:  # noqa: ANN401
    """A value as JSON holds it; a register by its fields."""
    return asdict(value) if is_dataclass(value) and not isinstance(value, type) else value


def _rows(of: Any, sources: Mapping[str, str]) -> Iterator[tuple[str, str, str]]:  # noqa: ANN401
    """The fields that have a value."""
    every: tuple[Field[Any], ...] = fields(of)
    for name in (field.name for field in every if field.name not in _SAID):
        value = getattr(of, name)
        if value is not None and value != ():
            yield name, _text(value), sources.get(name, "")


def _text(value: object) -> str:
    """A value in words: `24 bits, wrap`, `zero, subtract`, `yes`."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if is_dataclass(value) and not isinstance(value, type):
        named = {key: _text(part) for key, part in vars(value).items() if part is not None}
        return ", ".join(f"{key} {part}" for key, part in named.items())
    if isinstance(value, tuple):
        return ", ".join(map(_text, value))
    return f"{value:g}" if isinstance(value, float) else str(value)


def energy_facts(table: EnergyTable, chips: str) -> list[tuple[str, str]]:
    """Where a table's numbers come from, and how certain they are."""
    facts = [
        ("chips", chips),
        ("source", table.source),
        ("provenance", table.provenance),
        ("energy is", f"{describe_certainty(table)}: {table.uncertainty.why}"),
    ]
    if table.timed:
        facts.append(
            ("time is", f"{table.time_uncertainty.describe()}: {table.time_uncertainty.why}")
        )
        facts.append(("a timestep", f"{scaled(table.step)}s"))
    if table.included:
        facts.append(("included in others", ", ".join(table.included)))
    return facts


def energy_events(table: EnergyTable) -> list[tuple[str, ...]]:
    """A row of EVENT_COLUMNS for each event that has a price or a time."""
    names = dict.fromkeys([*table.joules, *table.seconds])
    prices = (table.joules, table.upper_joules, table.seconds)
    units = ("J", "J", "s")
    return [
        (name, *(_si(each.get(name), unit) for each, unit in zip(prices, units, strict=True)))
        for name in names
    ]


def _si(value: float | None, unit: str) -> str:
    """`23.6 pJ`, `8.4 ns`."""
    if value is None:
        return "–"
    return f"{1e12 * value:.4g} pJ" if unit == "J" else f"{1e9 * value:.4g} ns"


def policy_facts(name: str, card: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Where a shipped policy comes from, by its card."""
    policy = card.get("config", {}).get("policy", {})
    facts = {
        **{key: card.get(key) for key in ("file", "kind", "env", "recipe", "seed", "steps")},
        "network": ", ".join(
            f"{key} {_listed(value)}" for key, value in policy.items() if value is not None
        ),
        "created": card.get("created"),
        "note": card.get("note"),
    }
    return [
        ("name", name),
        *((key, str(value)) for key, value in facts.items() if value not in (None, "")),
    ]


def _listed(value: object) -> str:
    return " × ".join(map(str, value)) if isinstance(value, list) else str(value)
