"""`spikedeploy experiment`: many trainings and their evaluations, a page at the end."""

from pathlib import Path
from typing import Annotated

import typer

from spikedeploy.commands.options import Json


def experiment(
    name: Annotated[str, typer.Argument(metavar="NAME", help="Which: kart.")],
    seeds: Annotated[int, typer.Option(min=1, help="Trainings of each network.")] = 5,
    controls: Annotated[int, typer.Option(min=0, help="Trainings of each control.")] = 3,
    only: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME",
            help="Parts by prefix of their names: kart-grid, kart-grid-snn-s0.",
            show_default="all",
        ),
    ] = None,
    jobs: Annotated[
        int | None, typer.Option(min=1, help="Processes side by side.", show_default="all cores")
    ] = None,
    finishes: Annotated[
        int, typer.Option(min=0, help="Finishes that end a training; 0 spends the whole budget.")
    ] = 0,
    set_: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="KEY=VALUE", help="One setting of every training."),
    ] = None,
    episodes: Annotated[int, typer.Option(min=1, help="Episodes of each evaluation.")] = 100,
    chip: Annotated[str, typer.Option(help="Chip of the spiking policies.")] = "loihi1",
    folder: Annotated[Path, typer.Option(help="Where the run folders are.")] = Path(
        "runs/experiment-kart"
    ),
    output: Annotated[
        Path, typer.Option("-o", "--output", help="Where kart.md and kart/ are written.")
    ] = Path("results"),
    train: Annotated[
        bool, typer.Option(help="Run missing parts; --no-train only writes the page.")
    ] = True,
    json: Json = False,
) -> None:
    """Train, export and evaluate all parts of an experiment; resume where it stopped."""
    from importlib import import_module

    from spikedeploy.console import print_json
    from spikedeploy.experiments import EXPERIMENTS
    from spikedeploy.parallel import cores
    from spikedeploy.runtime.errors import ConfigError

    if name not in EXPERIMENTS:
        raise ConfigError(f"unknown experiment {name!r}; known: {', '.join(EXPERIMENTS)}")
    module, _, function = EXPERIMENTS[name].partition(":")
    design = import_module("spikedeploy.experiments.kart_design").ExperimentDesign(
        seeds, controls, str(folder), tuple(set_ or ()), finishes, episodes, chip
    )
    run = getattr(import_module(module), function)
    outcome = run(design, only or (), jobs or cores(), output, train)
    if json:
        files = [str(path) for path in outcome.files]
        print_json({**vars(outcome), "files": files})
    else:
        typer.echo(f"{outcome.done} of {outcome.of} parts are complete: {outcome.files[0]}")
        for part, line in outcome.failed.items():
            typer.echo(f"failed: {part}: {line}", err=True)
    raise typer.Exit(130 if outcome.interrupted else 1 if outcome.failed else 0)
