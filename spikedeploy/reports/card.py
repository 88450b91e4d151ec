"""The card of a shipped policy as a Markdown page."""

import shlex
from collections.abc import Mapping
from typing import Any

from spikedeploy.reports.columns import markdown as tables_of

KINDS = {
    "ann": "float network (ONNX)",
    "snn": "spiking network (NIR)",
    "control": "control: a float policy that is kept simple, to see what a network is worth (ONNX)",
}


def markdown(name: str, record: Mapping[str, Any]) -> str:
    """The page: provenance, evaluation, parity, learning curve."""
    rows = record["evaluation"]
    facts = {
        "what": KINDS[record["kind"]],
        "environment": record["env"],
        "made by": f"`{command(record)}`",
        "environment steps": f"{record['steps']:,}",
        "commit": record["commit"] or "unknown",
        "exported": record["created"],
        "evaluated on": f"{rows[0]['episodes']} episodes, seeds from 10000 up",
    } | ({"note": record["note"]} if record["note"] else {})
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
            *tables_of(rows),
            "## Parity of the file with the trained policy",
            "",
            *checks,
            "",
            "## Learning curve",
            "",
            f"![learning curve]({name}.png)",
            "",
        ]
    )


def command(record: Mapping[str, Any]) -> str:
    """The command that trained the policy."""
    options = [f"--set {shlex.quote(change)}" for change in record["overrides"]]
    return " ".join([f"spikedeploy train {record['recipe']} --seed {record['seed']}", *options])
