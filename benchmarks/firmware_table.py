"""The table of docs/firmware.md."""

from pathlib import Path

PAGE = Path(__file__).parent.parent / "docs/firmware.md"
START, END = "<!-- firmware -->\n", "<!-- end of firmware -->\n"
_HEAD = (
    "policy", "ROM [kB]", "RAM [kB]", "M4 instructions", "at most", "RV32 instructions", "at most",
    "host [µs]", "runtime / C", "spikes compared", "steps that differ",
)  # fmt: skip

_COUNTS = ("instructions", "instructions_max")


def table(rows: list[dict]) -> str:
    """Rows as a table in Markdown; a dash where a tool was missing."""
    lines = [_line(_HEAD), _line(["---", *["---:"] * (len(_HEAD) - 1)])]
    return "\n".join([*lines, *(_line(_cells(row)) for row in rows)]) + "\n"


def written(rows: list[dict], episodes: int) -> None:
    """Put the table, and what it is of, into the page."""
    text = PAGE.read_text(encoding="utf-8")
    head, rest = text.split(START)
    _, tail = rest.split(END)
    said = f"Of {episodes} episodes each, made by `python benchmarks/firmware.py --write`:\n\n"
    PAGE.write_text(f"{head}{START}{said}{table(rows)}{END}{tail}", encoding="utf-8")


def _cells(row: dict) -> list[str]:
    arm, risc = row["cortex-m4"], row["rv32imac"]
    return [
        row["policy"],
        _thousands(arm, "rom"),
        _thousands(arm, "static"),
        *(_count(core, key) for core in (arm, risc) for key in _COUNTS),
        f"{row['host_ns'] / 1000:.2f}",
        f"{row['ratio']:.3g}",
        f"{row['spikes']:,}",
        f"{row['differing']:,} of {row['steps']:,}",
    ]


def _thousands(found: dict, key: str) -> str:
    return f"{found[key] / 1000:.1f}" if key in found else "–"


def _count(found: dict, key: str) -> str:
    return f"{found[key]:,}" if key in found else "–"


def _line(cells: "list[str] | tuple[str, ...]") -> str:
    return f"| {' | '.join(cells)} |"
