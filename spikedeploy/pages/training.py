"""The page of a training run, while it is trained and at its end."""

import json
import shlex
import time
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from spikedeploy.files import write_text
from spikedeploy.outputs import no_link
from spikedeploy.pages.page import big_numbers, commands, facts, figure, folded, heading, page, said
from spikedeploy.pages.svg import svg
from spikedeploy.policies import run_record
from spikedeploy.reports.headline import HeadlineNumber
from spikedeploy.reports.run_curves import curves_figure
from spikedeploy.reports.run_scores import RunScores, metrics_of, scores
from spikedeploy.runtime.errors import SpikedeployError

PAGE = "report.html"
_CAPTION = "A line that leaves its panel goes on far beyond it, so that the rest can be read."
ALT = "Return, success, spike rate and operations over the training"
_RELOAD = 20  # [s] between two pages of a run that is trained
_SHARE = 0.02  # of the time that pages may take


class LivePage:
    """Writes the page of a run while it is trained: rarely enough to cost nothing."""

    def __init__(self) -> None:
        self._due = 0.0

    def __call__(self, run: Path) -> None:
        """Write it, if one is due; what hinders that does not end the training."""
        began = time.monotonic()
        if began < self._due:
            return
        with suppress(OSError, SpikedeployError):
            write_run_page(run, live=True)
        took = time.monotonic() - began
        self._due = began + max(_RELOAD, took / _SHARE)


def write_run_page(run: Path, live: bool = False) -> Path:
    """Write report.html into a run folder.

    live  whether this process trains in it
    """
    return write_text(no_link(run / PAGE), run_page(scores(run), live))


def run_page(found: RunScores, live: bool = False) -> str:
    """The page of a run as one file."""
    live = live or found.running
    drawn = curves_figure(metrics_of(found.path))
    settings = run_record.settings(found.path)
    versions = run_record.versions(found.path)
    return page(
        found.name,
        _lead(found, live),
        [
            big_numbers(_numbers(found, settings)),
            heading("Curves"),
            figure(svg(drawn, ALT), _CAPTION) if drawn else said("No episode has ended yet."),
            heading("What to do next"),
            commands(_next(found, live)),
            folded("Settings", facts(flat(settings))),
            folded(
                "Versions", facts((name, str(number or "–")) for name, number in versions.items())
            ),
        ],
        reload=_RELOAD if live else 0,
    )


def _lead(found: RunScores, live: bool) -> str:
    what = f"{found.recipe} in {found.env}, training seed {found.seed}"
    if live:
        return (
            f"{what}: at work, {found.share:.0%} at the last checkpoint. This page reloads itself."
        )
    if found.share < 1:
        return f"{what}: stopped at {found.share:.0%}."
    return f"{what}: trained to its end."


def _numbers(found: RunScores, settings: Mapping[str, Any]) -> Iterator[HeadlineNumber]:
    if found.earned is not None:
        episodes = dict(flat(settings)).get("validation.episodes", "some")
        beside = f"mean of {episodes} greedy episodes, which chose the checkpoint"
        yield HeadlineNumber("best validation return", f"{found.earned:,.4g}", (beside,))
    if found.success is not None:
        yield HeadlineNumber("success", f"{found.success:.0%}", ("of these episodes",))
    if found.operations is not None:
        number = f"{found.operations:,.4g} {found.counts}"
        yield HeadlineNumber("operations of a control step", number, ("in the same validation",))
    if found.rate is not None:
        yield HeadlineNumber(
            "spike rate", f"{found.rate:.1%}", ("of neurons in each timestep, on average",)
        )
    steps, unit = found.steps
    yield HeadlineNumber("training", f"{found.share:.0%}", (f"{steps:,} {unit}",))


def _next(found: RunScores, live: bool) -> Iterator[tuple[str, str]]:
    """Command lines, and what they do."""
    run = shlex.quote(str(found.path))
    if found.share < 1 and not live:
        yield f"spikedeploy train --resume {run}", "go on with the training"
    yield f"spikedeploy compare {shlex.quote(found.env)} {run}", "compare it on fresh seeds"
    yield f"spikedeploy run {run} -o reports/{shlex.quote(found.name)}", "replay an episode"
    yield f"spikedeploy export {run} --to card --film", "make the folder ready to be uploaded"


def flat(settings: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, str]]:
    """Settings with their groups in their names, as --set takes them."""
    for key, value in settings.items():
        if isinstance(value, Mapping) and value:
            yield from flat(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value if isinstance(value, str) else json.dumps(value)
