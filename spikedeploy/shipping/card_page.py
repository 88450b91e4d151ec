"""The card of a shipped policy and its page: written, and after a new evaluation written again."""

import json
import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from spikedeploy.files import as_text, replacing
from spikedeploy.outputs import check_output
from spikedeploy.reports.columns import markdown_tables
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.shipping.record_fields import check_page
from spikedeploy.trainers.recipes import RECIPES
from spikedeploy.trainers.run_folder import LEVEL
from spikedeploy.trainers.versions import versions

KINDS = {
    "ann": "float network (ONNX)",
    "snn": "spiking network (NIR)",
    "control": "control: a small float policy, a baseline for the spiking ones (ONNX)",
}


def markdown(name: str, record: Mapping[str, Any]) -> str:
    """The page: provenance, evaluation, parity, learning curve."""
    checks = [
        f"- {'✓' if c['passed'] else '✗'} {c['name']}: {c['detail']}" for c in record["parity"]
    ]
    return "\n".join(
        [
            *head(name, record),
            "",
            "## Evaluation",
            "",
            markdown_tables(record["evaluation"]),
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


def head(name: str, record: Mapping[str, Any]) -> list[str]:
    """The first lines of the page: its name and the facts."""
    facts = {
        "what": KINDS[record["kind"]],
        "environment": record["env"],
        "made by": ", then ".join(f"`{training_command(r)}`" for r in [*record["before"], record]),
        "checkpoint": _checkpoint(record["checkpoint"]),
        record["steps_unit"]: _steps(record),
        "commit": record["commit"] or "unknown",
        "exported": record["created"],
        "evaluated on": f"{record['evaluation'][0]['episodes']} episodes, seeds from 10000 up",
    } | ({"note": record["note"]} if record["note"] else {})
    return [f"# {name}", "", *(f"- {key}: {value}" for key, value in facts.items())]


def training_command(record: Mapping[str, Any]) -> str:
    """The command that trained the policy."""
    changes = dict(change.partition("=")[::2] for change in record["overrides"])
    what = record["recipe"]
    if what in RECIPES and RECIPES[what].any_env:
        what = f"{json.loads(changes.pop('env.name'))} --recipe {what}"
    options = [f"--set {shlex.quote(f'{key}={value}')}" for key, value in changes.items()]
    return " ".join([f"spikedeploy train {what} --seed {record['seed']}", *options])


def _checkpoint(name: str) -> str:
    """What a checkpoint is of, where its name does not say it."""
    operations = name.removeprefix(LEVEL)
    if operations == name:
        return name
    return f"{name}, the best of those pruned to {float(operations):g} operations a control step"


def _steps(record: Mapping[str, Any]) -> str:
    """How long the policy was trained, and the one that it began with."""
    starts = [r for r in record["before"] if r["gives"] == "start"]
    after = "".join(f", after {r['steps']:,} {r['steps_unit']} by imitation" for r in starts)
    return f"{record['steps']:,}{after}"


def evaluated(file: str, seeds: range, rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """The fields of a card that an evaluation fills."""
    return {
        "seeds": {"first": seeds[0], "count": len(seeds)},
        "evaluated_with": versions(),
        "evaluation": [{**row, "file": file} for row in rows],
    }


def check_rewritable(card: Path, force: bool = False) -> None:
    """Refuse a card that lacks what its page says, and a page that is not of this card."""
    record = json.loads(card.read_text(encoding="utf-8"))
    check_page(card, record, list(KINDS))
    try:
        first = head(card.stem, record)[:4]  # its name, what it is, and its environment
    except (KeyError, ValueError) as error:
        raise ConfigError(f"{card}: its 'overrides' do not say how it was trained") from error
    page = card.with_suffix(".md")
    check_output("--update", page, (card,), force, lambda path: _begins(path, first))


def _begins(page: Path, lines: Sequence[str]) -> bool:
    """Whether a page begins with these lines."""
    with page.open(encoding="utf-8", errors="replace") as file:
        return all(file.readline() == f"{line}\n" for line in lines)


def write_evaluation(
    card: Path, sha256: str, seeds: range, rows: Sequence[Mapping[str, Any]]
) -> None:
    """Write rows of a new evaluation into a card and its page: into both or neither."""
    record = json.loads(card.read_text(encoding="utf-8"))
    kept = {key: value for key, value in record.items() if key not in ("file", "sha256")}
    identity = {"file": record["file"], "sha256": sha256}
    record = identity | kept | evaluated(record["file"], seeds, rows)
    texts = as_text(record), markdown(card.stem, record)
    with replacing(card) as data, replacing(card.with_suffix(".md")) as page:
        for part, text in zip((data, page), texts, strict=True):
            part.write_text(text, encoding="utf-8")
