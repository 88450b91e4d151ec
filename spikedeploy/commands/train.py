"""`spikedeploy train`: a recipe in, a run folder out."""

from pathlib import Path
from typing import Annotated

import typer

from spikedeploy import seeds
from spikedeploy.commands.options import Json


def train(
    recipe: Annotated[
        str, typer.Argument(metavar="RECIPE", help="Name of a recipe; `recipes` lists them.")
    ],
    config: Annotated[
        Path | None, typer.Option(exists=True, dir_okay=False, help="TOML file with settings.")
    ] = None,
    set_: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="KEY=VALUE", help="One setting, as in --set env.count=8."),
    ] = None,
    seed: Annotated[
        int | None,
        typer.Option(
            min=seeds.TRAINING.start,
            max=seeds.TRAINING.stop - 1,
            help="Seed of the training.",
            show_default="0",
        ),
    ] = None,
    resume: Annotated[
        str | None, typer.Option(metavar="RUN|last", help="Go on with a run, or with the newest.")
    ] = None,
    runs: Annotated[Path, typer.Option(help="Folder in which the run folder is made.")] = Path(
        "runs"
    ),
    json: Json = False,
) -> None:
    """Train a policy. Ctrl-C stops at a checkpoint; --resume last goes on."""
    if resume is not None and seed is not None:
        raise typer.BadParameter("a resumed run keeps its seed: leave --seed out")
    from spikedeploy.console import print_json
    from spikedeploy.trainers.train import train as learn

    run = learn(
        recipe,
        config_file=config,
        overrides=set_ or (),
        seed=seed or 0,
        resume=resume,
        runs=runs,
        quiet=json,
    )
    if json:
        print_json({"run": str(run)})
    else:
        typer.echo(f"trained: {run}\nnext: spikedeploy visualize {run}")
