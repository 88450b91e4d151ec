"""Publishing: a run becomes a shipped policy, with a card: how it was made, and how it does."""

import shutil
from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from spikedeploy import envs, zoo
from spikedeploy.comparison.closed_loop import DEFAULT_CHIP
from spikedeploy.comparison.lineup import Entry
from spikedeploy.comparison.rounds import compare
from spikedeploy.files import as_text, replacing, write_text
from spikedeploy.policies import run_record
from spikedeploy.policies.interface import FLOAT
from spikedeploy.policies.registry import find
from spikedeploy.reports.card import markdown
from spikedeploy.reports.curves import curve
from spikedeploy.reports.plots import draw_curves
from spikedeploy.runtime.errors import SpikedeployError
from spikedeploy.seeds import EVALUATION
from spikedeploy.shipping.export_run import SPIKING, Exported, export
from spikedeploy.trainers.config import differences
from spikedeploy.trainers.run_folder import RunFolder
from spikedeploy.trainers.train import algorithm


def publish(
    run: str,
    name: str,
    episodes: int,
    folder: Path = zoo.FOLDER,
    processes: int | None = None,
    note: str = "",
    control: bool = False,
) -> list[Path]:
    """Put a run's policy into the zoo, with its card and its learning curve; the files written.

    run       run folder, its name under runs/, or "last"
    name      of the policy in the zoo, such as "popsan"
    episodes  of its evaluation, on each chip that its card names
    folder    of the zoo
    note      what a reader should know that the run folder does not say
    control   whether comparisons shall show it as a control, such as a network that is kept small
    """
    source = RunFolder.find(run).path
    target = folder / envs.spec(run_record.settings(source)["env"]["name"]).short
    with TemporaryDirectory() as stage:  # so that a failure leaves the zoo as it was
        exported = _exported(source, Path(stage) / name, control)
        record = describe(source, exported, episodes, processes) | {"note": note}
        file = _copied(exported.path, target / exported.path.name)
    return [
        file,
        write_text(file.with_suffix(".json"), as_text(record)),
        write_text(file.with_suffix(".md"), markdown(name, record)),
        draw_curves([curve(source / "metrics.csv", name)], file.with_suffix(".png")),
        _copied(source / "metrics.csv", file.with_suffix(".csv")),
    ]


def describe(
    source: Path, exported: Exported, episodes: int, processes: int | None
) -> dict[str, Any]:
    """The card as data: how the policy was made, and how it does."""
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
    """What was set beside the recipe."""
    kind = algorithm(run_record.settings(source)["algorithm"])
    return differences(RunFolder(source).config(kind.Config))


def _exported(source: Path, path: Path, control: bool) -> Exported:
    """The run's policy as a file that does what the policy does."""
    to = "nir" if run_record.settings(source)["policy"]["kind"] in SPIKING else "onnx"
    exported = export(str(source), to, path.with_suffix(f".{to}"), control=control)
    failed = [check.name for check in exported.checks if not check.passed]
    if failed:
        raise SpikedeployError(f"the file does not do what {source} does: {', '.join(failed)}")
    return exported


def _portable(data: Any) -> Any:  # noqa: ANN401
    """Settings with paths inside this folder as they look from it, such as a teacher's."""
    if isinstance(data, dict):
        return {key: _portable(value) for key, value in data.items()}
    if isinstance(data, list | tuple):
        return [_portable(value) for value in data]
    return data.replace(f"{Path.cwd()}/", "") if isinstance(data, str) else data


def _evaluation(
    path: Path, source: Path, episodes: int, processes: int | None
) -> list[Mapping[str, Any]]:
    """Rows of the policy alone: as a float network, and on the default chip if it spikes."""
    candidate = find(str(path))
    entries = [Entry(candidate)]
    if candidate.kind == "snn":
        twin = Entry(candidate, FLOAT)
        entries = [twin, Entry(candidate, DEFAULT_CHIP, twin)]
    world = run_record.settings(source)["env"]
    seeds = range(EVALUATION, EVALUATION + episodes)
    rows = compare(world["name"], entries, seeds, processes, world["options"]).as_json()
    return [{**row, "file": path.name} for row in rows]


def _copied(source: Path, target: Path) -> Path:
    with replacing(target) as part:
        shutil.copyfile(source, part)
    return target
