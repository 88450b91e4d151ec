"""The card of a run, card.md: what the policy is, how it was trained, what it earns, its limits.

Its head is that of a model card of the Hugging Face hub, so that a run folder can be uploaded.
"""

from pathlib import Path

from spikedeploy import envs
from spikedeploy.exporters.check import ExportResult
from spikedeploy.outputs import check_output, has_text, mark, no_link
from spikedeploy.policies import run_record
from spikedeploy.reports.page import standalone_svg
from spikedeploy.reports.plots import curves_figure, svg
from spikedeploy.reports.runs import ALT, flatten, metrics_of, scores, write_run_page
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.files import write_text
from spikedeploy.seeds import EVALUATION
from spikedeploy.setup import Setup
from spikedeploy.shipping.cards import KINDS, fill, training_of
from spikedeploy.shipping.exported_run import runnable
from spikedeploy.shipping.training_films import last_film
from spikedeploy.trainers.run_folder import RunFolder

CARD, CURVE, FILM = "card.md", "curve.svg", "replay.mp4"
_OURS = f"<!-- {mark('train')}; without this line it is kept as it is -->"


def write_run_files(run: Path) -> list[Path]:
    """Write report.html, curve.svg and card.md anew into a run folder; the ones that were written.

    A card that a person has taken over, who deleted our line in it, is kept.
    """
    files = [write_run_page(run)]
    if drawn := curves_figure(metrics_of(run)):
        files.append(write_text(no_link(run / CURVE), standalone_svg(svg(drawn, ALT))))
    card = no_link(run / CARD)
    if not card.exists() or has_text(card, _OURS):
        files.append(write_text(card, card_of(run)))
    return files


def export_card(
    policy: str, path: Path | None = None, *, film: bool = False, force: bool = False
) -> ExportResult:
    """Make a run folder ready to be uploaded.

    policy: run folder, its name under runs/, or "last".
    film: whether to film one greedy episode of the policy, on its chip if it spikes.
    force: whether a card or film that a person wrote is replaced.
    """
    if path is not None:
        raise ConfigError("--to card is of the run folder: leave -o out")
    run = RunFolder.find(policy).path
    if not force and (run / CARD).exists() and not has_text(run / CARD, _OURS):
        raise ConfigError(
            f"{run / CARD} was written by hand: keep it and copy the rest of the folder, or "
            "replace it with --force"
        )
    if film:
        written = mark("run")
        check_output("--film", run / FILM, (), force, lambda path: has_text(path, written))
    file = Path(runnable(str(run)))
    filmed = [_filmed(file, run)] if film else []
    (run / CARD).unlink(missing_ok=True)
    names = tuple(str(each) for each in [file, *filmed, *write_run_files(run)])
    return ExportResult(run, names, lines=(f"wrote {', '.join(names)}",))


def _filmed(policy: Path, run: Path) -> Path:
    """One episode of the exported policy as MP4."""
    from spikedeploy.comparison.evaluation import run_policy

    world = run_record.settings(run)["env"]
    seeds = range(EVALUATION, EVALUATION + 1)
    setup = Setup.with_options(world["options"])
    run_policy(str(policy), world["name"], None, seeds, setup, run / FILM)
    return run / FILM


def card_of(run: Path) -> str:
    """The card of a run as Markdown, behind YAML."""
    found, settings, film = scores(run), run_record.settings(run), last_film(run)
    values = {
        "mean_reward": ("validation return", found.earned),
        "success_rate": ("validation success", found.success),
        "operations": (f"{found.counts} of a control step", found.operations),
    }
    metrics = [
        {"type": kind, "name": name, "value": value, "verified": False}
        for kind, (name, value) in values.items()
        if value is not None
    ]
    return fill(
        "run_card",
        found=found,
        settings=settings,
        metrics=metrics,
        mark=_OURS,
        kind=KINDS["snn" if found.spikes else "ann"],
        tags=["spiking-neural-network", "neuromorphic", "nir"] if found.spikes else ["onnx"],
        spec=envs.spec(settings["env"]["name"]),
        record=training_of(run),
        versions=run_record.versions(run),
        episodes=dict(flatten(settings)).get("validation.episodes", "some"),
        trained_film=film.relative_to(run).as_posix() if film else "",
        has_film=(run / FILM).is_file(),
        film=FILM,
        has_curve=(run / CURVE).is_file(),
        curve=CURVE,
        alt=ALT,
    )
