"""`train --seeds`: one recipe with several seeds side by side, and what they came to."""

from pathlib import Path
from typing import Any

import typer


def run_seeds(
    text: str,
    jobs: int | None,
    json: bool,
    runs: Path,
    recipe: str | None,
    config_file: Path | None,
    **settings: Any,  # noqa: ANN401
) -> None:
    """Train with each seed of a text such as `0-4`; print a line each and a table."""
    from spikedeploy.campaign.training_seeds import train_seeds
    from spikedeploy.console import print_json, print_text, say
    from spikedeploy.jobs.pool import cores
    from spikedeploy.reports.table import Table
    from spikedeploy.seeds import training_seeds
    from spikedeploy.trainers.config import known
    from spikedeploy.trainers.recipes import RECIPES

    known(str(recipe), RECIPES, "recipe")  # refuses an unknown one before processes are started
    seeds = training_seeds("--seeds", text)
    count = min(jobs or cores(), len(seeds))
    file = str(config_file) if config_file else None
    arguments = {"recipe": recipe, "config_file": file, "runs": str(runs), **settings}
    say(f"{len(seeds)} trainings, {count} at a time; logs in {runs / 'logs'}")
    found = train_seeds(seeds, count, runs / "logs", arguments, lambda each: say(each.line))
    if json:
        print_json(found.as_json())
    else:
        rows = [
            (str(e.seed), "–" if e.best is None else f"{e.best:,.4g}", e.run or "–")
            for e in found.each
        ]
        Table(("seed", "best validation return", "run"), rows, str(recipe)).print()
        if (mean := found.estimate) is not None:
            low, high = mean.ci95
            between = f", 95% bootstrap interval {low:,.4g} to {high:,.4g}"
            print_text(f"mean {mean.mean:,.4g}{between if len(seeds) > 1 else ''}")
    if found.interrupted:
        for each in found.each:
            if each.run and each.stopped:
                say(f"go on with `spikedeploy train --resume {each.run}`")
        raise typer.Exit(130)
    raise typer.Exit(1 if any(each.failed for each in found.each) else 0)
