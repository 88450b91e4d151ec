"""A run becomes a shipped policy: its file, and its card as JSON and as a page in Markdown.

    python -m lab publish RUN --name popsan [--episodes 100] [--control] [--note TEXT]
    python -m lab publish --update kart-steer/sparse   # numbers that a new version counts otherwise

The card says how the policy was trained, that the file is the trained policy, and what it earns:
`spikedeploy reproduce` plays the evaluation on it again.
"""

import argparse
import json
import re
import shlex
import shutil
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

from spikedeploy import envs, zoo
from spikedeploy.comparison.evaluation import compare_policies, make_entries
from spikedeploy.console import say
from spikedeploy.evaluation_setup import Setup
from spikedeploy.exporters.check import ExportResult
from spikedeploy.outputs import check_output_folder, has_text
from spikedeploy.policies import run_record
from spikedeploy.policies.registry import DEFAULT_CHIP, find
from spikedeploy.reports.columns import markdown_tables
from spikedeploy.reports.plots import draw_curves, read_curve
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.files import as_text, read_json, replacing, write_json, write_text
from spikedeploy.seeds import EVALUATION
from spikedeploy.shipping.export_run import export_run
from spikedeploy.shipping.reproduce import read_evaluation
from spikedeploy.trainers.config import differences
from spikedeploy.trainers.recipes import RECIPES
from spikedeploy.trainers.run_folder import LEVEL, RunFolder
from spikedeploy.trainers.sparse.sparse_ppo import find_start
from spikedeploy.trainers.train import algorithm
from spikedeploy.trainers.versions import versions

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]*")
_KINDS = {
    "ann": "float network (ONNX)",
    "snn": "spiking network (NIR)",
    "control": "control: a small float policy, a baseline for the spiking ones (ONNX)",
}
# settings of algorithms that follow from the run that they start from, and that name other runs
_DERIVED = {"sparse-ppo": ("policy.",)}
_NEEDED = {"sparse": ("pool",), "sparse-ppo": ("start",)}


def publish_run(
    run: str,
    name: str,
    episodes: int,
    folder: Path = zoo.FOLDER,
    processes: int | None = None,
    note: str = "",
    control: bool = False,
    checkpoint: str | None = None,
    force: bool = False,
) -> list[Path]:
    """Put a run's policy into a zoo, with card and learning curve; return the files.

    run: run folder, its name under runs/, or "last"
    name: name of the policy in the zoo, such as "popsan"
    episodes: episodes of its evaluation, on each chip of the card
    folder: folder of the zoo
    note: for the card
    control: whether comparisons show it as a control, such as a small network
    checkpoint: checkpoint of the run, such as "ops-480"; by default its best, else its last
    force: whether files of this name that are no published policy are replaced
    """
    if not _NAME.fullmatch(name):
        raise ConfigError(
            f"--name {name!r}: a policy of the zoo has a name of letters, digits, - and _ alone, "
            "such as popsan; its environment is that of the run"
        )
    source = RunFolder.find(run).path
    target = folder / envs.spec(run_record.settings(source)["env"]["name"]).short
    names = [f"{name}.{kind}" for kind in ("nir", "onnx", "json", "md", "png", "csv")]
    check_output_folder("-o", target, names, (source,), force, partial(_has_card, name))
    with TemporaryDirectory() as stage:  # so that a failure leaves the zoo unchanged
        to = run_record.format_of(source)
        part = Path(stage) / f"{name}.{to}"
        exported = export_run(str(source), to, part, control=control, checkpoint=checkpoint)
        record = describe(source, exported.require_passed(str(source)), checkpoint)
        record |= _evaluate(part, source, episodes, processes)
        record = {key: _portable(value) for key, value in record.items()} | {"note": note}
        if old := [path.name for path in sorted(target.glob(f"{name}.*"))]:
            say(f"replaced in {target}: {', '.join(old)}")
        file = _copy(part, target / part.name)
    for suffix in set(zoo.SUFFIXES) - {file.suffix}:  # one name is one policy
        file.with_suffix(suffix).unlink(missing_ok=True)
    return [
        file,
        write_json(file.with_suffix(".json"), record),
        write_text(file.with_suffix(".md"), page(name, record)),
        draw_curves([read_curve(source / "metrics.csv", name)], file.with_suffix(".png")),
        _copy(source / "metrics.csv", file.with_suffix(".csv")),
    ]


def _has_card(name: str, folder: Path) -> bool:
    """True where a policy of this name was published into the folder."""
    card = folder / f"{name}.json"
    return card.is_file() and has_text(card, '"evaluation"')


def _copy(source: Path, target: Path) -> Path:
    with replacing(target) as part:
        shutil.copyfile(source, part)
    return target


# The card as data.


def describe(source: Path, exported: ExportResult, checkpoint: str | None = None) -> dict[str, Any]:
    """The card as data, without its evaluation: training and parity."""
    origin = run_record.origin(source, checkpoint)
    return {
        "file": exported.path.name,
        "sha256": zoo.sha256(exported.path),
        "kind": exported.facts["kind"],
        "env": origin.env,
        **_training(source, checkpoint),
        "before": list(_runs_before(source)),
        "commit": run_record.versions(source)["commit"],
        "created": origin.created,
        "versions": run_record.versions(source),
        "config": run_record.settings(source),
        "parity": [vars(check) for check in exported.checks],
    }


def _training(run: Path, checkpoint: str | None = None) -> dict[str, Any]:
    """The training of a run up to a checkpoint, with the settings that differ from the recipe."""
    settings = run_record.settings(run)
    steps, unit = run_record.steps(run, checkpoint)
    changes = differences(RunFolder(run).config(algorithm(settings["algorithm"]).Config))
    derived = _DERIVED.get(settings["algorithm"], ())
    return {
        "recipe": settings["recipe"],
        "seed": settings["seed"],
        "checkpoint": RunFolder(run).deployed(checkpoint),
        "steps": steps,
        "steps_unit": unit,
        "overrides": [each for each in changes if not each.startswith(derived)],
    }


def _runs_before(source: Path) -> Iterator[dict[str, Any]]:
    """The runs that a run needs, in the order of training: for its walks, or as its start."""
    settings, told = run_record.settings(source), set()
    for setting in _NEEDED.get(settings["algorithm"], ()):
        if not settings.get(setting):  # absent from runs of earlier versions
            continue
        run = find_start(settings[setting], source.parent).path
        checkpoint = settings.get("start_checkpoint")
        if setting == "start" and checkpoint is None:  # what is pruned most
            checkpoint = next(iter(RunFolder(run).levels.values()), None)
        own = _training(run, checkpoint) | {"run": run.name, "gives": setting}
        for each in (*_runs_before(run), own):
            if each["run"] not in told:
                yield each
            told.add(each["run"])


def _evaluate(path: Path, source: Path, episodes: int, processes: int | None) -> dict[str, Any]:
    """Rows of the policy: in float, and if it spikes on its training's chip, or the default."""
    settings = run_record.settings(source)
    own = settings.get("chip") or settings["policy"].get("chip")
    world = settings["env"]
    setup = Setup.with_options(world["options"])
    entries = make_entries(find(str(path)), own or DEFAULT_CHIP, setup)
    seeds = range(EVALUATION, EVALUATION + episodes)
    rows = compare_policies(world["name"], entries, seeds, processes).as_json()
    return evaluation_fields(path.name, seeds, rows)


def evaluation_fields(file: str, seeds: range, rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """The fields of a card that an evaluation fills."""
    return {
        "seeds": {"first": seeds[0], "count": len(seeds)},
        "evaluated_with": versions(),
        "evaluation": [{**row, "file": file} for row in rows],
    }


def _portable(data: Any) -> Any:  # noqa: ANN401
    """Settings in which paths below the current folder are relative, such as a teacher's."""
    if isinstance(data, dict):
        return {key: _portable(value) for key, value in data.items()}
    if isinstance(data, list | tuple):
        return [_portable(value) for value in data]
    return data.replace(f"{Path.cwd()}/", "") if isinstance(data, str) else data


# The card as a page.


def page(name: str, record: Mapping[str, Any]) -> str:
    """The card as Markdown: training, evaluation, parity, learning curve."""
    made = Environment(
        loader=PackageLoader("lab"),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    checkpoint = record["checkpoint"]
    return made.get_template("card.md.j2").render(
        name=name,
        record=record,
        kinds=_KINDS,
        level=checkpoint.removeprefix(LEVEL) if checkpoint.startswith(LEVEL) else "",
        tables=markdown_tables(record["evaluation"]),
        command=_training_command,
    )


def _training_command(record: Mapping[str, Any]) -> str:
    """The command that trained the policy."""
    changes = dict(change.partition("=")[::2] for change in record["overrides"])
    what = record["recipe"]
    if what in RECIPES and RECIPES[what].any_env:
        what = f"{json.loads(changes.pop('env.name'))} --recipe {what}"
    options = [f"--set {shlex.quote(f'{key}={value}')}" for key, value in changes.items()]
    return " ".join([f"spikedeploy train {what} --seed {record['seed']}", *options])


def update_card(name: str, processes: int | None = None) -> None:
    """Play a card's evaluation again and write it anew; ConfigError where a return differs."""
    recorded = read_evaluation(name)
    if recorded.card is None:
        raise ConfigError(f"--update {name}: a report has no card")
    played = compare_policies(recorded.env, recorded.entries, recorded.seeds, processes)
    found = json.loads(as_text(played.as_json()))  # as a file would have them
    for then, now in zip(recorded.rows, found, strict=True):
        if then["returns"] != now["returns"]:
            raise ConfigError(f"{name}: {then['policy']} has other returns now. The card is kept.")
    record = read_json(recorded.card)
    record |= evaluation_fields(record["file"], recorded.seeds, found)
    write_json(recorded.card, record)
    write_text(recorded.card.with_suffix(".md"), page(recorded.card.stem, record))


def main() -> None:
    """Publish a run, or update cards."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("run", nargs="?", help="run folder, its name under runs/, or last")
    parser.add_argument("--update", nargs="+", metavar="POLICY", default=[])
    parser.add_argument("--name", default="")
    parser.add_argument("--episodes", type=int, default=100)
    parser.add_argument("--note", default="")
    parser.add_argument("--control", action="store_true")
    parser.add_argument("--checkpoint")
    parser.add_argument("--workers", type=int)
    parser.add_argument("--output", type=Path, default=zoo.FOLDER)
    parser.add_argument("--force", action="store_true")
    said = parser.parse_args()
    if not (said.update or (said.run and said.name)):
        parser.error("give RUN and --name, or --update")
    for name in said.update:
        update_card(name, said.workers)
    if said.run:
        files = publish_run(
            said.run, said.name, said.episodes, said.output, said.workers, said.note,
            said.control, said.checkpoint, said.force,
        )  # fmt: skip
        print(f"wrote {', '.join(map(str, files))}")
