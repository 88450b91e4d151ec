"""`distill`: from anybody's teacher to a spiking student."""

from pathlib import Path
from typing import Annotated

import typer

from spikedeploy.commands.options import Encoders, Json
from spikedeploy.commands.training import ForChip, Resume, Runs, TrainingSeed, run_training


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
    chip: ForChip = None,
    set_: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="KEY=VALUE", help="One setting, as in --set updates=8000."),
    ] = None,
    seed: TrainingSeed = None,
    resume: Resume = None,
    runs: Runs = Path("runs"),
    json: Json = False,
) -> None:
    """Train a spiking student that imitates a teacher. A function of yours runs as your code."""
    if resume is None and (teacher is None or env is None):
        raise typer.BadParameter("name a TEACHER and --env ENV, or a run with --resume")
    from spikedeploy.trainers.distill.plan import earned, student_settings, teacher_options

    recipe, settings = student_settings(teacher, size, encoder, timesteps, budget is not None, chip)
    run_training(
        recipe if resume is None else None,
        json,
        env=env,
        overrides=[*settings, *(set_ or ())],
        budget=budget,
        seed=seed,
        resume=resume,
        runs=runs,
        remark=earned,
        baselines=teacher_options,
    )
