"""`distill`: from anybody's teacher to a spiking student."""

from pathlib import Path
from typing import Annotated

import typer

from spikedeploy import seeds
from spikedeploy.commands.options import Encoders, Json
from spikedeploy.commands.training import tell_end


def distill(
    teacher: Annotated[
        str | None,
        typer.Argument(
            metavar="TEACHER",
            help="Policy to imitate: .onnx (of rsl_rl too), .zip of Stable-Baselines3, "
            "my_module:function, a run folder, or a shipped policy.",
            show_default="with --resume that of the run",
        ),
    ] = None,
    env: Annotated[
        str | None,
        typer.Option(
            metavar="ENV",
            help="Short name, id of gymnasium, or module:Class.",
            show_default="with --resume that of the run",
        ),
    ] = None,
    size: Annotated[
        str | None,
        typer.Option(
            metavar="N,N…",
            help="Neurons of the hidden layers; one layer with --budget.",
            show_default="64,64, or the recipe's",
        ),
    ] = None,
    encoder: Annotated[
        Encoders | None,
        typer.Option(
            help="Code of the observation.", show_default="population; delta with --budget"
        ),
    ] = None,
    timesteps: Annotated[
        int | None,
        typer.Option(min=1, help="Timesteps T of an inference.", show_default="8; 1 with --budget"),
    ] = None,
    budget: Annotated[
        str | None,
        typer.Option(
            metavar="sops=N",
            help="Synaptic operations of a control step: an event-driven student, pruned to them.",
            show_default="none",
        ),
    ] = None,
    set_: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="KEY=VALUE", help="One setting, as in --set updates=8000."),
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
        str | None, typer.Option(metavar="RUN|last", help="Resume a run, or the newest.")
    ] = None,
    runs: Annotated[Path, typer.Option(help="Folder in which the run folder is made.")] = Path(
        "runs"
    ),
    json: Json = False,
) -> None:
    """Train a spiking student that imitates a teacher. A function of yours runs as your code."""
    if resume is not None and seed is not None:
        raise typer.BadParameter("a resumed run keeps its seed: leave --seed out")
    if resume is None and (teacher is None or env is None):
        raise typer.BadParameter("name a TEACHER and --env ENV, or a run with --resume")
    from spikedeploy.trainers.distill.plan import earned, student_settings
    from spikedeploy.trainers.train import Interrupt, train

    recipe, settings = student_settings(teacher, size, encoder, timesteps, budget is not None)
    interrupt = Interrupt()
    run = train(
        recipe if resume is None else None,
        env=env,
        overrides=[*settings, *(set_ or ())],
        budget=budget,
        seed=seed or 0,
        resume=resume,
        runs=runs,
        quiet=json,
        interrupt=interrupt,
    )
    tell_end(run, interrupt.share, runs, json, earned(run))
