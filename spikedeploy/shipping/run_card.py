"""The card of a run, card.md: what the policy is, how it was trained, what it earns, its limits.

Its head is that of a model card of the Hugging Face hub, so that a run folder can be uploaded.
"""

import json
import shlex
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from spikedeploy import envs
from spikedeploy.files import write_text
from spikedeploy.outputs import check_output, mark, marked, no_link
from spikedeploy.policies import run_record
from spikedeploy.reports.page import standalone_svg
from spikedeploy.reports.plots import curves_figure, svg
from spikedeploy.reports.runs import ALT, RunScores, flatten, metrics_of, scores, write_run_page
from spikedeploy.reports.table import escape_markdown
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.seeds import EVALUATION
from spikedeploy.shipping.cards import KINDS, training_command, training_of
from spikedeploy.shipping.exported_run import runnable
from spikedeploy.shipping.training_films import last_film
from spikedeploy.trainers.run_folder import RunFolder

CARD, CURVE, FILM = "card.md", "curve.svg", "replay.mp4"
_OURS = f"<!-- {mark('train')}; without this line it is kept as it is -->"
_LIMITS = """\
- Validation episodes chose the checkpoint, so their return is optimistic: `compare` plays seeds
  that training never saw.
- Chips are emulated. Energies are estimates from published tables, not measurements.
- One training seed says little about the recipe: `spikedeploy train RECIPE --seeds 0-4`.
- It was trained in simulation, in this environment alone."""


def write_run_files(run: Path) -> list[Path]:
    """Write report.html, curve.svg and card.md anew into a run folder; the ones that were written.

    A card that a person has taken over, who deleted our line in it, is kept.
    """
    files = [write_run_page(run)]
    if drawn := curves_figure(metrics_of(run)):
        files.append(write_text(no_link(run / CURVE), standalone_svg(svg(drawn, ALT))))
    card = no_link(run / CARD)
    if not card.exists() or marked(card, _OURS):
        files.append(write_text(card, card_of(run)))
    return files


def export_card(reference: str, film: bool = False, force: bool = False) -> list[Path]:
    """Make a run folder ready to be uploaded; the files for it.

    reference  run folder, its name under runs/, or "last"
    film       whether to film one greedy episode of the policy, on its chip if it spikes
    force      whether a card or film that a person wrote is replaced
    """
    run = RunFolder.find(reference).path
    if not force and (run / CARD).exists() and not marked(run / CARD, _OURS):
        raise ConfigError(
            f"{run / CARD} was written by hand: keep it and copy the rest of the folder, or "
            "replace it with --force"
        )
    if film:
        written = mark("run")
        check_output("--film", run / FILM, (), force, lambda path: marked(path, written))
    policy = Path(runnable(str(run)))
    filmed = [_filmed(policy, run)] if film else []
    (run / CARD).unlink(missing_ok=True)
    return [policy, *filmed, *write_run_files(run)]


def _filmed(policy: Path, run: Path) -> Path:
    """One episode of the exported policy as MP4."""
    from spikedeploy.comparison.evaluation import run_policy

    world = run_record.settings(run)["env"]
    seeds = range(EVALUATION, EVALUATION + 1)
    run_policy(str(policy), world["name"], None, seeds, run / FILM, options=world["options"])
    return run / FILM


def card_of(run: Path) -> str:
    """The card of a run as Markdown, behind YAML."""
    found, settings, film = scores(run), run_record.settings(run), last_film(run)
    parts = [
        "\n".join(["---", *_head(found), "---"]),
        _OURS,
        f"# {found.name}",
        _what(found, settings),
        f"[A greedy episode, filmed]({FILM})" if (run / FILM).is_file() else "",
        f"![A greedy episode]({film.relative_to(run).as_posix()})" if film else "",
        "## Environment",
        "\n".join(_environment(settings)),
        "## Training",
        "\n".join(_training(run, found)),
        f"![{ALT}]({CURVE})" if (run / CURVE).is_file() else "",
        "## Results",
        "\n".join(_results(found, settings)),
        "## How to use it",
        "\n".join(f"    {line}" for line in _use(found)),
        "## Limits",
        _LIMITS,
    ]
    return "\n\n".join(part for part in parts if part) + "\n"


def _head(found: RunScores) -> Iterator[str]:
    """YAML, of which JSON is a part: tags and metrics as the hub reads them."""
    spiking = ["spiking-neural-network", "neuromorphic", "nir"] if found.spikes else ["onnx"]
    yield "library_name: spikedeploy"
    yield "pipeline_tag: reinforcement-learning"
    yield f"tags: {json.dumps(['reinforcement-learning', 'robotics', *spiking, found.env])}"
    if found.earned is not None:
        result = {
            "task": {"type": "reinforcement-learning", "name": "reinforcement-learning"},
            "dataset": {"name": found.env, "type": found.env},
            "metrics": _metrics(found),
        }
        yield f"model-index: {json.dumps([{'name': found.name, 'results': [result]}])}"


def _metrics(found: RunScores) -> list[dict[str, Any]]:
    values = {
        "mean_reward": ("validation return", found.earned),
        "success_rate": ("validation success", found.success),
        "operations": (f"{found.counts} of a control step", found.operations),
    }
    return [
        {"type": kind, "name": name, "value": value, "verified": False}
        for kind, (name, value) in values.items()
        if value is not None
    ]


def _what(found: RunScores, settings: Mapping[str, Any]) -> str:
    kind = KINDS["snn" if found.spikes else "ann"]
    sizes = settings["policy"].get("hidden")
    hidden = f", hidden {json.dumps(sizes)}" if sizes else ""
    done = "" if found.share == 1 else f" Its training is unfinished: {found.share:.0%}."
    return f"A {kind} for `{found.env}`: a `{found.kind}`{hidden}, trained by spikedeploy.{done}"


def _environment(settings: Mapping[str, Any]) -> Iterator[str]:
    world = settings["env"]
    spec = envs.spec(world["name"])
    yield f"- {spec.id}" if spec.foreign else f"- {spec.id}: {spec.summary}"
    for key, value in world["options"].items():
        yield f"- {escape_markdown(str(key))}: {escape_markdown(json.dumps(value))}"


def _training(run: Path, found: RunScores) -> Iterator[str]:
    record, versions = training_of(run), run_record.versions(run)
    yield f"- `{training_command(record)}`"
    yield f"- checkpoint {record['checkpoint']}, after {record['steps']:,} {record['steps_unit']}"
    commit = escape_markdown(str(versions.get("commit") or "unknown"))
    yield f"- {found.share:.0%} done, spikedeploy's commit {commit}"
    told = [f"{name} {version}" for name, version in versions.items() if version]
    yield "- " + ", ".join(escape_markdown(each) for each in told if not each.startswith("commit "))


def _results(found: RunScores, settings: Mapping[str, Any]) -> Iterator[str]:
    if found.earned is None:
        yield "No validation yet."
        return
    episodes = dict(flatten(settings)).get("validation.episodes", "some")
    yield f"Validation, {episodes} greedy episodes:"
    yield ""
    yield from (f"- {each['name']}: {each['value']:,.4g}" for each in _metrics(found))


def _use(found: RunScores) -> Iterator[str]:
    run, env = shlex.quote(found.name), shlex.quote(found.env)
    yield f"spikedeploy compare {env} {run}    # fresh seeds, beside its float twin"
    yield f"spikedeploy run {run} --episodes 5"
    if found.spikes:
        yield f"spikedeploy export {run} --to c -o firmware    # C99 of its integers"
