"""Publishing: a run becomes a shipped policy, with a Markdown card on training and evaluation."""

import shlex
import shutil
from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from spikedeploy import envs, zoo
from spikedeploy.comparison.lineup import Entry
from spikedeploy.comparison.rounds import compare_policies
from spikedeploy.files import as_text, replacing, write_text
from spikedeploy.policies import run_record
from spikedeploy.policies.interface import DEFAULT_CHIP, FLOAT
from spikedeploy.policies.registry import find
from spikedeploy.reports.columns import markdown as tables_of
from spikedeploy.reports.curves import curve
from spikedeploy.reports.plots import draw_curves
from spikedeploy.runtime.errors import SpikedeployError
from spikedeploy.seeds import EVALUATION
from spikedeploy.shipping.export_run import SPIKING, ExportedPolicy, export_run
from spikedeploy.trainers.config import differences
from spikedeploy.trainers.run_folder import RunFolder
from spikedeploy.trainers.train import algorithm

_KINDS = {
    "ann": "float network (ONNX)",
    "snn": "spiking network (NIR)",
    "control": "control: a float policy that is kept simple, to see what a network is worth (ONNX)",
}


def markdown(name: str, record: Mapping[str, Any]) -> str:
    """The page: provenance, evaluation, parity, learning curve."""
    rows = record["evaluation"]
    facts = {
        "what": _KINDS[record["kind"]],
        "environment": record["env"],
        "made by": f"`{_command(record)}`",
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


def _command(record: Mapping[str, Any]) -> str:
    """The command that trained the policy."""
    options = [f"--set {shlex.quote(change)}" for change in record["overrides"]]
    return " ".join([f"spikedeploy train {record['recipe']} --seed {record['seed']}", *options])


def publish_run(
    run: str,
    name: str,
    episodes: int,
    folder: Path = zoo.FOLDER,
    processes: int | None = None,
    note: str = "",
    control: bool = False,
) -> list[Path]:
    """Put a run's policy into the zoo, with card and learning curve; return the files.

    run       run folder, its name under runs/, or "last"
    name      of the policy in the zoo, such as "popsan"
    episodes  of its evaluation, on each chip of the card
    folder    of the zoo
    note      for the card
    control   whether comparisons show it as a control, such as a small network
    """
    source = RunFolder.find(run).path
    target = folder / envs.spec(run_record.settings(source)["env"]["name"]).short
    with TemporaryDirectory() as stage:  # so that a failure leaves the zoo unchanged
        exported = _exported(source, Path(stage) / name, control)
        record = _describe(source, exported, episodes, processes) | {"note": note}
        file = _copied(exported.path, target / exported.path.name)
    return [
        file,
        write_text(file.with_suffix(".json"), as_text(record)),
        write_text(file.with_suffix(".md"), markdown(name, record)),
        draw_curves([curve(source / "metrics.csv", name)], file.with_suffix(".png")),
        _copied(source / "metrics.csv", file.with_suffix(".csv")),
    ]


def _describe(
    source: Path, exported: ExportedPolicy, episodes: int, processes: int | None
) -> dict[str, Any]:
    """The card as data: training, parity and evaluation."""
    origin = run_record.origin(source)
    record = {
        "file": exported.path.name,
        "kind": exported.kind,
        "env": origin.env,
        "recipe": origin.recipe,
        "seed": origin.seed,
        "steps": origin.steps,
        "commit": run_record.versions(source)["commit"],
        "created": origin.created,
        "versions": run_record.versions(source),
        "config": run_record.settings(source),
        "overrides": _overrides(source),
        "parity": [vars(check) for check in exported.checks],
        "evaluation": _evaluation(exported.path, source, episodes, processes),
    }
    return {key: _portable(value) for key, value in record.items()}


def _overrides(source: Path) -> list[str]:
    """Settings that differ from the recipe."""
    kind = algorithm(run_record.settings(source)["algorithm"])
    return differences(RunFolder(source).config(kind.Config))


def _exported(source: Path, path: Path, control: bool) -> ExportedPolicy:
    """The run's policy as a file that passes its parity checks."""
    to = "nir" if run_record.settings(source)["policy"]["kind"] in SPIKING else "onnx"
    exported = export_run(str(source), to, path.with_suffix(f".{to}"), control=control)
    failed = [check.name for check in exported.checks if not check.passed]
    if failed:
        raise SpikedeployError(f"the file does not do what {source} does: {', '.join(failed)}")
    return exported


def _portable(data: Any) -> Any:  # noqa: ANN401
    """Settings in which paths below the current folder are relative, such as a teacher's."""
    if isinstance(data, dict):
        return {key: _portable(value) for key, value in data.items()}
    if isinstance(data, list | tuple):
        return [_portable(value) for value in data]
    return data.replace(f"{Path.cwd()}/", "") if isinstance(data, str) else data


def _evaluation(
    path: Path, source: Path, episodes: int, processes: int | None
) -> list[Mapping[str, Any]]:
    """Rows of the policy: in float, and on the default chip if it spikes."""
    candidate = find(str(path))
    entries = [Entry(candidate)]
    if candidate.kind == "snn":
        twin = Entry(candidate, FLOAT)
        entries = [twin, Entry(candidate, DEFAULT_CHIP, twin)]
    world = run_record.settings(source)["env"]
    seeds = range(EVALUATION, EVALUATION + episodes)
    rows = compare_policies(world["name"], entries, seeds, processes, world["options"]).as_json()
    return [{**row, "file": path.name} for row in rows]


def _copied(source: Path, target: Path) -> Path:
    with replacing(target) as part:
        shutil.copyfile(source, part)
    return target
