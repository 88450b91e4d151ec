"""`tune`: a search for the settings of a recipe."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from spikedeploy import seeds
from spikedeploy.commands.options import Json

_Objective = Literal["return", "return-at-sops", "return,sops"]


def tune(
    recipe: Annotated[
        str, typer.Argument(metavar="RECIPE", help="Name of a recipe; `recipes` lists them.")
    ],
    env: Annotated[
        str | None,
        typer.Option(help="Environment of a recipe for any: short name, id, or module:Class."),
    ] = None,
    objective: Annotated[
        _Objective,
        typer.Option(
            help="Return; return within --sops; or both return and SOPs, with the Pareto front."
        ),
    ] = "return",
    sops: Annotated[
        float | None,
        typer.Option(min=1, metavar="N", help="Most SOPs of a control step, of return-at-sops."),
    ] = None,
    search: Annotated[
        list[str] | None,
        typer.Option(
            metavar="KEY=low..high[:log]|KEY=a|b",
            help="What a setting may be, may be repeated.",
            show_default="the recipe's own; docs/tuning.md lists them",
        ),
    ] = None,
    set_: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="KEY=VALUE", help="One setting of every training."),
    ] = None,
    trials: Annotated[int, typer.Option(min=1, help="Trials of the search in all.")] = 50,
    jobs: Annotated[int, typer.Option(min=1, help="Processes side by side, a core each.")] = 1,
    episodes: Annotated[int, typer.Option(min=1, help="Episodes that judge a trial.")] = 20,
    chip: Annotated[
        str | None,
        typer.Option(
            help="Chip of a spiking policy; 'float' for its float twin.",
            show_default="that which it is trained for, or loihi1",
        ),
    ] = None,
    seed: Annotated[
        int,
        typer.Option(
            min=seeds.TRAINING.start, max=seeds.TRAINING.stop - 1, help="Seed of the trainings."
        ),
    ] = 0,
    storage: Annotated[
        str | None,
        typer.Option(
            metavar="URL",
            help="Database of the search, for several machines, such as postgresql://…",
            show_default="a journal file in the folder",
        ),
    ] = None,
    folder: Annotated[
        Path | None,
        typer.Option(
            help="Folder of the search, which goes on there.", show_default="runs/tune/RECIPE"
        ),
    ] = None,
    json: Json = False,
) -> None:
    """Search for the settings of a recipe with Optuna; go on where it stopped."""
    from spikedeploy.campaign.tune import tune as find
    from spikedeploy.campaign.tune_plan import TuningPlan
    from spikedeploy.campaign.tune_results import PAGE, SHOWN, is_study
    from spikedeploy.console import print_json, say
    from spikedeploy.outputs import check_output_folder

    plan = TuningPlan(
        recipe=recipe, env=env or "", objective=objective, sops=sops or 0.0,
        search=tuple(search or ()), fixed=tuple(set_ or ()), seed=seed, episodes=episodes,
        chip=chip or "",
    )  # fmt: skip
    where = folder or Path("runs/tune") / "-".join(filter(None, (recipe, plan.title)))
    # a study goes on; other people's files of these names stay
    check_output_folder("--folder", where, (PAGE, SHOWN, "journal.log"), (), False, is_study)
    found = find(plan, where, trials, jobs, storage, (lambda line: None) if json else say)
    if json:
        print_json(
            {
                "trials": [vars(trial) for trial in found.trials],
                "best": [
                    {**vars(trial), "command": plan.command(trial.settings)} for trial in found.best
                ],
                "files": [str(path) for path in found.files],
            }
        )
    else:
        for trial in found.best:
            typer.echo(plan.command(trial.settings))
        typer.echo(f"wrote {where / PAGE}")
    raise typer.Exit(130 if found.interrupted else 0 if found.best else 1)
