"""`experiment`: many trainings and evaluations by one command."""

from pathlib import Path
from typing import Annotated

import typer

from spikedeploy.cli import run
from spikedeploy.commands.options import Force, Json


def experiment(
    name: Annotated[
        str, typer.Argument(metavar="NAME", help="kart, pareto, robustness, gymnasium or lineup.")
    ],
    env: Annotated[
        str | None,
        typer.Argument(metavar="[ENV]", help="Environment; of kart none, of gymnasium one task."),
    ] = None,
    seeds: Annotated[
        int | None,
        typer.Option(
            min=1, help="Trainings of each network.", show_default="kart, lineup 5; others 3"
        ),
    ] = None,
    controls: Annotated[
        int | None, typer.Option(min=0, help="kart: trainings of each control.", show_default="5")
    ] = None,
    only: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME",
            help="Parts by prefix of their names: kart-grid, kart-grid-snn-s0; kart: *-classic.",
            show_default="all",
        ),
    ] = None,
    jobs: Annotated[
        int | None,
        typer.Option(
            min=1, help="Processes side by side.", show_default="kart all cores, others 1"
        ),
    ] = None,
    finishes: Annotated[
        int | None,
        typer.Option(
            min=0,
            help="kart: finishes that end a training; 0 spends the whole budget.",
            show_default="0; classic preset 300",
        ),
    ] = None,
    set_: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="KEY=VALUE",
            help="One setting of every training; robustness: an option of the environment.",
        ),
    ] = None,
    policies: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME,…",
            help="robustness: policies, as `compare` takes them; needed for other people's ENV.",
            show_default="all that are shipped",
        ),
    ] = None,
    episodes: Annotated[
        int | None,
        typer.Option(
            min=1,
            help="Episodes of each evaluation.",
            show_default="100; karts of pareto 300; robustness 30; gymnasium 50",
        ),
    ] = None,
    chip_episodes: Annotated[
        int | None,
        typer.Option(
            min=1, help="pareto: episodes on other chips and in fewer bits.", show_default="30"
        ),
    ] = None,
    levels: Annotated[
        int | None,
        typer.Option(
            min=1, help="pareto: how many of the last levels are evaluated.", show_default="all"
        ),
    ] = None,
    chip: Annotated[
        str | None, typer.Option(help="Chip of the spiking policies.", show_default="loihi1")
    ] = None,
    folder: Annotated[
        Path | None,
        typer.Option(
            "--folder",
            "--runs",
            help="Where the run folders are.",
            show_default="runs/experiment-kart, runs/NAME/ENV, runs/gymnasium, runs/lineup",
        ),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option(
            "-o",
            "--output",
            help="Where the page NAME.md and NAME/ are written.",
            show_default="results; with --quick runs/NAME-quick",
        ),
    ] = None,
    train: Annotated[
        bool, typer.Option(help="Run missing parts; --no-train only writes the page.")
    ] = True,
    quick: Annotated[
        bool, typer.Option("--quick", help="Trainings and episodes of seconds, a first look.")
    ] = False,
    force: Force = False,
    json: Json = False,
) -> None:
    """Train, export and evaluate all parts of an experiment; resume where it stopped."""
    from importlib import import_module

    from lab.experiments import EXPERIMENTS
    from spikedeploy.console import print_json
    from spikedeploy.outputs import check_output_folder, marked
    from spikedeploy.runtime.errors import ConfigError

    if name not in EXPERIMENTS:
        raise ConfigError(f"unknown experiment {name!r}; known: {', '.join(EXPERIMENTS)}")
    given = {
        "env": env, "seeds": seeds, "controls": controls, "finishes": finishes,
        "set": tuple(set_) if set_ else None, "episodes": episodes, "chip-episodes": chip_episodes,
        "policies": tuple(policies) if policies else None, "levels": levels, "chip": chip,
        "runs": folder and str(folder), "quick": quick or None,
    }  # fmt: skip
    run_missing, asked = (
        getattr(import_module(module), function)
        for module, _, function in (path.partition(":") for path in EXPERIMENTS[name])
    )
    design = asked({option: value for option, value in given.items() if value is not None})
    output = output or Path(f"runs/{name}-quick" if quick else "results")
    page = f"{name}.md"
    check_output_folder(
        "-o",
        output,
        (page, f"{name}.html"),
        (),
        force,
        lambda at: marked(at / page, "python -m lab"),
    )
    outcome = run_missing(design, only or (), jobs, output, train)
    if json:
        files = [str(path) for path in outcome.files]
        print_json({**vars(outcome), "files": files})
    else:
        typer.echo(f"{outcome.done} of {outcome.of} parts are complete: {outcome.files[0]}")
        for part, line in outcome.failed.items():
            typer.echo(f"failed: {part}: {line}", err=True)
    raise typer.Exit(130 if outcome.interrupted else 1 if outcome.failed else 0)


def main() -> None:
    """Run the command of sys.argv."""
    app = typer.Typer(pretty_exceptions_enable=False)
    app.command(context_settings={"help_option_names": ["-h", "--help"]})(experiment)
    run(app)
