"""The card of a shipped policy, as a page for people."""

from collections.abc import Mapping, Sequence
from typing import Any

from spikedeploy.columns import ABSENT, Column, Row, cost_columns, walk_columns

KINDS = {
    "ann": "float network (ONNX)",
    "snn": "spiking network (NIR)",
    "control": "control: a float policy that is kept simple, to see what a network is worth (ONNX)",
}


def markdown(name: str, record: Mapping[str, Any]) -> str:
    """The page: what it is, how it was made, how it does."""
    rows = record["evaluation"]
    walk = [column for column in walk_columns(rows) if _says_something(column, rows)]
    cost = [column for column in cost_columns(rows) if _says_something(column, rows)]
    facts = {
        "what": KINDS[record["kind"]],
        "environment": record["env"],
        "made by": f"`{command(record)}`",
        "environment steps": f"{record['steps']:,}",
        "commit": record["commit"] or "unknown",
        "exported": record["created"],
        "evaluated on": f"{rows[0]['episodes']} episodes, seeds from 10000 up",
    }
    checks = [
        f"- {'✓' if c['passed'] else '✗'} {c['name']}: {c['detail']}" for c in record["parity"]
    ]
    return "\n".join(
        [
            f"# {name}",
            "",
            *(f"- {key}: {value}" for key, value in facts.items()),
            "",
            "## Evaluation",
            "",
            *_table(walk, rows),
            "",
            *_table(cost, rows),
            "",
            "## Parity of the file with the trained policy",
            "",
            *checks,
            "",
            "## Learning curve",
            "",
            f"![return against environment steps]({name}.png)",
            "",
        ]
    )


def command(record: Mapping[str, Any]) -> str:
    """The command that trains the policy again."""
    return f"spikedeploy train {record['recipe']} --seed {record['seed']}"


def _says_something(column: Column, rows: Sequence[Row]) -> bool:
    return any(column.cell(row) != ABSENT for row in rows)


def _table(columns: Sequence[Column], rows: Sequence[Row]) -> list[str]:
    lines = [[column.title for column in columns], ["---"] * len(columns)]
    lines += [[column.cell(row) for column in columns] for row in rows]
    return [f"| {' | '.join(line)} |" for line in lines]
