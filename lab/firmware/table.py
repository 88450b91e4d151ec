"""The tables of docs/firmware.md."""

import argparse
import json
from collections.abc import Iterable, Sequence
from pathlib import Path

from spikedeploy.files import write_text

PAGE = Path(__file__).parents[2] / "docs/firmware.md"
# places of the tables on the page
OWN, PEERS, NETWORKS, INTEGERS = "firmware", "peers", "networks", "integers"
_HEAD = (
    "policy", "ROM [kB]", "RAM [kB]", "M4 instructions", "at most", "RV32 instructions", "at most",
    "host [µs]", "runtime / C", "spikes compared", "steps that differ",
)  # fmt: skip

_PEER_HEAD = (
    "policy", "C by", "return", "ROM [kB]", "RAM [kB]", "M4 instructions", "at most",
    "with FPU", "host [ns]", "times sparse",
)  # fmt: skip
_NETWORK_HEAD = (
    "spiking layers of", "C by", "ROM [kB]", "M4 instructions", "at most", "with FPU",
    "host [ns]", "times ours", "counts unlike float",
)  # fmt: skip
_CORES = {"cortex-m0": "M0", "cortex-m3": "M3", "cortex-m4": "M4", "cortex-m4f": "M4F",
          "rv32imac": "RV32"}  # fmt: skip
_INTEGER_HEAD = (
    "policy", "computed in", "return", "beside its own in float", "ROM [kB]", "RAM [kB]",
    *_CORES.values(),
)  # fmt: skip
_COUNTS = ("instructions", "instructions_max")


def table(rows: list[dict]) -> str:
    """Rows as a table in Markdown; a dash where a tool was missing."""
    return _table(_HEAD, map(_cells, rows))


def options_of(doc: str, only: str) -> argparse.ArgumentParser:
    """The options that all of the commands have."""
    parser = argparse.ArgumentParser(description=doc.splitlines()[0])
    parser.add_argument("--only", default="", help=only)
    parser.add_argument("--write", action="store_true", help="the table into docs/firmware.md")
    parser.add_argument("--json", action="store_true")
    return parser


def publish(
    options: argparse.Namespace, rows: list[dict], text: str, place: str, intro: str = ""
) -> None:
    """Print the rows or their table; with --write put it between the marks of its place."""
    print(json.dumps(rows) if options.json else text)
    if options.write:
        _put(place, intro + text)


def _put(place: str, text: str) -> None:
    start, end = f"<!-- {place} -->\n", f"<!-- end of {place} -->\n"
    head, rest = PAGE.read_text(encoding="utf-8").split(start)
    _, tail = rest.split(end)
    write_text(PAGE, f"{head}{start}{text}{end}{tail}")


def peer_table(rows: list[dict]) -> str:
    """Policies beside those of other tools, as a table in Markdown."""
    return _table(_PEER_HEAD, map(_peer_cells, rows), names=2)


def _peer_cells(row: dict) -> list[str]:
    memory = [_thousands(row["cortex-m4"], key) for key in ("rom", "static")]
    return [row["policy"], row["by"], f"{row['return']:,.1f}", *memory, *_costs(row)]


def integer_table(rows: list[dict]) -> str:
    """Spiking and dense policies in integers, as a table in Markdown."""
    return _table(_INTEGER_HEAD, map(_integer_cells, rows), names=2)


def _integer_cells(row: dict) -> list[str]:
    own = row["difference"]
    memory = [_thousands(row["cortex-m4"], key) for key in ("rom", "static")]
    cores = [_parts(row[core]) for core in _CORES]
    return [row["policy"], row["by"], row["return"], own, *memory, *cores]


def _parts(found: dict) -> str:
    """Instructions of a step, and codec + network where they are told apart."""
    total = found["instructions"]
    if not found["network"]:
        return f"{total:,}"
    return f"{total:,} ({total - found['network']:,} + {found['network']:,})"


def network_table(rows: list[dict]) -> str:
    """Spiking networks alone, ours and snn-mlir's, as a table in Markdown."""
    return _table(_NETWORK_HEAD, map(_network_cells, rows), names=2)


def _network_cells(row: dict) -> list[str]:
    unlike = f"{row['unlike']:,} of {row['counts']:,}"
    return [row["policy"], row["by"], _thousands(row["cortex-m4"], "rom"), *_costs(row), unlike]


def _costs(row: dict) -> list[str]:
    """Instructions and time of a row beside other tools."""
    return [
        *(_count(row["cortex-m4"], key) for key in _COUNTS),
        _count(row["cortex-m4f"], "instructions"),
        f"{row['host_ns']:,.0f}",
        f"{row['ratio']:.2f}",
    ]


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


def _table(head: Sequence[str], rows: Iterable[Sequence[str]], names: int = 1) -> str:
    """names: columns to the left, of texts."""
    rule = ["---"] * names + ["---:"] * (len(head) - names)
    return "\n".join(map(_line, [head, rule, *rows])) + "\n"


def _line(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"
