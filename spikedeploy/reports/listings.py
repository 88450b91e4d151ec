"""The chips side by side, the energy tables, break-even lines: what listings of commands show."""

from collections.abc import Iterable
from typing import Any

from spikedeploy.reports.energy_columns import COMMON_TABLE
from spikedeploy.reports.entries import chip_json
from spikedeploy.reports.markdown import markdown_table
from spikedeploy.runtime.chips.chip import CHIPS, Chip, chip
from spikedeploy.runtime.metrics.break_even import BREAK_EVEN_TABLES, YAN2024, break_even_rate
from spikedeploy.runtime.metrics.energy import (
    STATIC,
    TABLES,
    EnergyTable,
    Uncertainty,
    describe_certainty,
)

CHIP_COLUMNS = (
    "name",
    "neurons",
    "weights",
    "membrane",
    "resets",
    "readouts",
    "clocks",
    "compared with",
)


def chip_rows(chips: Iterable[Chip]) -> list[tuple[str, ...]]:
    """A row of COLUMNS for each chip."""
    return [
        (
            chip.name,
            *chip.arithmetic.describe(),
            ", ".join(chip.resets),
            "on the host" if chip.membrane_output == "none" else chip.membrane_output,
            ", ".join(chip.clocks),
            chip.evidence,
        )
        for chip in chips
    ]


def chip_list(chips: Iterable[Chip]) -> list[dict[str, Any]]:
    """The same as plain data, with every field of the datasheets, and sources."""
    known = list(chips)
    return [
        {
            **dict(zip((c.replace(" ", "_") for c in CHIP_COLUMNS), row, strict=True)),
            "resets": each.resets,
            "clocks": each.clocks,
            "membrane_output": each.membrane_output,
            "summary": each.summary,
            "energy_tables": each.energy_tables,
            "sources": each.sources,
            **chip_json(each),
        }
        for each, row in zip(known, chip_rows(known), strict=True)
    ]


def chip_markdown(chips: Iterable[Chip]) -> str:
    """The same as a table of Markdown."""
    return "".join(f"{line}\n" for line in markdown_table([CHIP_COLUMNS, *chip_rows(chips)]))


_PICO, _NANO = 1e-12, 1e-9
ENERGY_COLUMNS = ("table", "chips", "energies [pJ]", "energy is", "times [ns]", "time is")


def price_list() -> dict[str, list[dict[str, Any]]]:
    """Tables and static powers as plain data."""
    return {
        "tables": [
            {
                "name": table.name,
                "chips": chips_of(table),
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
                "source": power.source,
                "provenance": power.provenance,
                "watts": power.watts,
                "share": power.share,
                "whole": power.whole,
            }
            for name, powers in STATIC.items()
            for power in powers
        ],
    }


def chips_of(table: EnergyTable) -> list[str]:
    """Chips whose datasheets name the table."""
    return [name for name in CHIPS if table.name in chip(name).energy_tables]


def energy_rows() -> list[tuple[str, ...]]:
    """A row of HEADS for each table."""
    return [
        (
            table.name,
            ", ".join(chips_of(table)) or "–",
            _energies(table),
            f"{describe_certainty(table)}: {table.uncertainty.why}",
            _times(table),
            f"{table.time_uncertainty.describe()}: {table.time_uncertainty.why}"
            if table.timed
            else "–",
        )
        for table in TABLES.values()
    ]


def energy_sources() -> list[tuple[str, str]]:
    """Table or static power, and its source."""
    tables = [(table.name, f"{table.source}: {table.provenance}") for table in TABLES.values()]
    powers = [
        (p.name, f"static, {name}: {p.watts * 1e3:g} mW, {p.whole}. {p.source}: {p.provenance}")
        for name, powers in STATIC.items()
        for p in powers
    ]
    return [*tables, *powers]


def energy_choice() -> str:
    """Which table to quote."""
    return (
        f"Quote {COMMON_TABLE} where spiking and float networks are compared: it prices both, with "
        "sums in registers; of pruned ones quote those with sums in memory (acc16, acc32) beside "
        "it. A chip's own tables are for that chip alone; say which."
    )


def energy_markdown() -> list[str]:
    """Tables and sources as lines of Markdown, for docs/energy.md."""
    table = markdown_table([ENERGY_COLUMNS, *energy_rows()])
    return [*table, "", *[f"* `{name}` – {source}." for name, source in energy_sources()]]


def _energies(table: EnergyTable) -> str:
    prices = {event: f"{joules / _PICO:.4g}" for event, joules in table.joules.items()}
    for event, joules in table.upper_joules.items():
        prices[event] += f" to {joules / _PICO:.4g}"
    return ", ".join(f"{event} {price}" for event, price in prices.items())


def _times(table: EnergyTable) -> str:
    events = [f"{event} {seconds / _NANO:.4g}" for event, seconds in table.seconds.items()]
    return ", ".join([*events, f"timestep {table.step / _NANO:,.10g}"]) if table.timed else "–"


def _uncertain(uncertainty: Uncertainty) -> dict[str, Any]:
    return {
        "low": uncertainty.low,
        "high": uncertainty.high,
        "is": uncertainty.describe(),
        "why": uncertainty.why,
    }


_TIMESTEPS = (1, 5, 16)
_FAN_INS = (None, 32, 128, 512)  # None leaves neuron updates out
_ACTIVITIES = (1.0, 0.5)  # dense, and half of the inputs skipped
BREAK_EVEN_COLUMNS = (
    "table",
    "T",
    *(
        kind if fan_in is None else f"{kind}, updates, fan-in {fan_in}"
        for kind in ("dense", "skips half")
        for fan_in in _FAN_INS
    ),
)
BREAK_EVEN_NOTE = (
    "Spikes per presynaptic neuron and timestep below which a spiking network costs less than a "
    "float network of the same shape. Yan et al. (arXiv 2409.08290v4) find "
    f"{100 * YAN2024:.1f} % at T = 5 in a model of their own, which has data movement, against a "
    "quantised network of 3 bits."
)


def break_even_list() -> list[dict[str, Any]]:
    """The lines as plain data; fan_in None is without neuron updates, activity 1 dense."""
    return [
        {
            "table": name,
            "timesteps": timesteps,
            "activity": activity,
            "fan_in": fan_in,
            "rate": break_even_rate(TABLES[name], timesteps, fan_in, activity),
        }
        for name in BREAK_EVEN_TABLES
        for timesteps in _TIMESTEPS
        for activity in _ACTIVITIES
        for fan_in in _FAN_INS
    ]


def break_even_rows() -> list[tuple[str, ...]]:
    """A row of BREAK_EVEN_COLUMNS for each table and number of timesteps."""
    rows: dict[tuple[str, int], list[str]] = {}
    for line in break_even_list():
        cells = rows.setdefault((line["table"], line["timesteps"]), [])
        cells.append(_rate(line["rate"]))
    return [(table, str(timesteps), *cells) for (table, timesteps), cells in rows.items()]


def break_even_markdown() -> list[str]:
    """The lines as a table of Markdown, for docs/energy.md."""
    return markdown_table([BREAK_EVEN_COLUMNS, *break_even_rows()])


def _rate(rate: float) -> str:
    """In percent; a spiking network costs more at any rate, or less at any."""
    return "never" if rate <= 0 else "always" if rate >= 1 else f"{100 * rate:.1f} %"
