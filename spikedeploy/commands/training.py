"""`train` and `visualize`: from a recipe to a run folder, and its curve."""

import shlex
from collections.abc import Callable
from contextlib import suppress
from json import dumps
from pathlib import Path
from typing import Annotated, Any

import typer

from spikedeploy import seeds
from spikedeploy.commands.options import Force, Json
from spikedeploy.commands.training_seeds import run_seeds

_RUNS = Path("runs")
TrainingSeed = Annotated[
    int | None,
    typer.Option(
        min=seeds.TRAINING.start,
        max=seeds.TRAINING.stop - 1,
        help="Seed of the training.",
        show_default="0",
    ),
]
ForChip = Annotated[
    str | None,
    typer.Option(
        "--for",
        metavar="CHIP",
        help="Train in the integers of this chip, imitating a teacher; recipe for-chip.",
        show_default="in float",
    ),
]
Resume = Annotated[
    str | None, typer.Option(metavar="RUN|last", help="Resume a run, or the newest.")
]
Runs = Annotated[Path, typer.Option(help="Folder in which the run folder is made.")]


def train(
    what: Annotated[
        str | None,
        typer.Argument(
            metavar="RECIPE|ENV",
            help="Name of a recipe; `recipes` lists them. With --recipe an environment: short "
            "name, id of gymnasium, or module:Class.",
            show_default="with --resume that of the run",
        ),
    ] = None,
    recipe: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="Recipe for any environment, such as ppo-snn or sac-popsan; `recipes` lists them.",
            show_default="the first argument",
        ),
    ] = None,
    chip: ForChip = None,
    config: Annotated[
        Path | None, typer.Option(exists=True, dir_okay=False, help="TOML file with settings.")
    ] = None,
    set_: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="KEY=VALUE", help="One setting, as in --set env.count=8."),
    ] = None,
    budget: Annotated[
        str | None,
        typer.Option(
            metavar="sops=N|macs=N",
            help="Operations of a control step, of sparse recipes: spiking or float.",
            show_default="the recipe's",
        ),
    ] = None,
    seed: TrainingSeed = None,
    several: Annotated[
        str | None,
        typer.Option(
            "--seeds",
            metavar="0-4|0,2,5",
            help="Train with several seeds side by side, each as a command of its own.",
            show_default="one training",
        ),
    ] = None,
    jobs: Annotated[
        int | None,
        typer.Option(min=1, help="With --seeds: trainings side by side.", show_default="all cores"),
    ] = None,
    resume: Resume = None,
    runs: Runs = _RUNS,
    films: Annotated[
        int,
        typer.Option(
            min=0,
            help="Films of a greedy episode of the best checkpoint so far, evenly over the "
            "training, the last at its end.",
        ),
    ] = 0,
    json: Json = False,
) -> None:
    """Train a policy. Ctrl-C stops at a checkpoint; --resume last goes on."""
    if what is None and (resume is None or recipe is not None):
        raise typer.BadParameter("name a RECIPE, an ENV with --recipe, or a run with --resume")
    if chip is not None:
        if what is None or recipe is not None:
            raise typer.BadParameter("--for goes with an ENV alone: train CartPole-v1 --for odin")
        recipe = "for-chip"
    settings: dict[str, Any] = {
        "env": what if recipe else None,
        "config_file": config,
        "overrides": [*_for_chip(what, chip, set_ or []), *(set_ or ())],
        "budget": budget,
    }
    if several is not None:
        if seed is not None or resume is not None:
            raise typer.BadParameter("--seeds goes without --seed and --resume")
        run_seeds(several, jobs, json, runs, recipe or what, films=films, **settings)
    if jobs is not None:
        raise typer.BadParameter("--jobs goes with --seeds")
    run_training(recipe or what, json, seed=seed, resume=resume, runs=runs, films=films, **settings)


def _for_chip(env: str | None, chip: str | None, given: list[str]) -> list[str]:
    """Settings that name the chip, and the shipped teacher of the environment unless one is."""
    if env is None or chip is None:
        return []
    settings = [f"policy.chip={dumps(chip)}"]
    if not any(each.replace(" ", "").startswith("teacher=") for each in given):
        from spikedeploy import envs, zoo
        from spikedeploy.envs.foreign import check_target, is_target
        from spikedeploy.runtime.errors import ConfigError

        envs.spec(env)  # refuses a name that none has, before it asks for a teacher
        if is_target(env):
            check_target(env)
        teacher = zoo.teacher(env)
        if teacher is None:
            raise ConfigError(
                f"no float teacher of {env} is shipped: give one with --set teacher=PATH, such as "
                f"the run of `spikedeploy train {env} --recipe ppo-mlp`, or imitate a Python "
                f"function of yours: `spikedeploy distill my_module:pilot --env {env} --for {chip}`"
            )
        settings.append(f"teacher={dumps(teacher)}")
    return settings


def run_training(
    recipe: str | None,
    json: bool,
    *,
    seed: int | None,
    resume: str | None,
    runs: Path,
    films: int = 0,
    remark: Callable[[Path], str] = lambda run: "",
    baselines: Callable[[Path], list[str]] = lambda run: [],
    **settings: Any,  # noqa: ANN401
) -> None:
    """Train; print where the run is, and what to do next; stopped by a signal, exit with its code.

    films     of a whole training
    remark    line on a training that ended
    baselines options of `compare`, for a training that ended
    settings  more arguments of trainers.train.train
    """
    if resume is not None and seed is not None:
        raise typer.BadParameter("a resumed run keeps its seed: leave --seed out")
    from spikedeploy.console import print_json, program_name, say
    from spikedeploy.reports.runs import LivePage
    from spikedeploy.shipping.exported_run import trained_in
    from spikedeploy.shipping.training_films import TrainingFilms
    from spikedeploy.trainers.progress import Interrupt
    from spikedeploy.trainers.train import train as learn

    interrupt, more = Interrupt(), {"seed": seed or 0, "resume": resume, "runs": runs, **settings}
    more |= {"watch": LivePage(), "film": TrainingFilms(films)}
    run = learn(recipe, quiet=json, interrupt=interrupt, **more)
    _show_run(run)
    if json:
        print_json({"run": str(run)})
    if interrupt.share is not None:
        where = "" if runs == _RUNS else f" --runs {runs}"
        again = f"go on with `spikedeploy train --resume last{where}`"
        with suppress(OSError):  # of a terminal that was closed
            say(f"stopped at {100 * interrupt.share:.0f} %; {again}")
        raise typer.Exit(interrupt.exit_code)
    if not json:
        env = trained_in(str(run))
        again = f"{program_name()} {shlex.join(['compare', str(env), str(run), *baselines(run)])}"
        typer.echo(f"trained: {run}\n{remark(run)}page: {run / 'report.html'}\nnext: {again}")


def _show_run(run: Path) -> None:
    """Write page, card and curves; where that fails, the training is none the worse."""
    from spikedeploy.console import say
    from spikedeploy.runtime.errors import SpikedeployError
    from spikedeploy.shipping.run_card import write_run_files
    from spikedeploy.user_errors import one_line

    try:
        write_run_files(run)
    except (OSError, SpikedeployError) as error:
        with suppress(OSError):  # of a terminal that was closed
            say(f"page and card are not written: {one_line(error) or error}")


def visualize(
    runs: Annotated[
        list[str],
        typer.Argument(help="Run folders, or their names under runs/.", metavar="RUN…"),
    ],
    output: Annotated[Path, typer.Option("-o", "--output", help="PNG to write.")] = Path(
        "reports/curves.png"
    ),
    force: Force = False,
    json: Json = False,
) -> None:
    """Draw the learning curves of training runs into one PNG."""
    from spikedeploy.console import print_json
    from spikedeploy.outputs import check_output, mark, marked
    from spikedeploy.reports.plots import draw_curves, read_curve
    from spikedeploy.trainers.run_folder import existing_run

    own = mark("visualize")
    folders = [Path(run) if Path(run).is_dir() else existing_run(run) for run in runs]
    check_output("-o", output, folders, force, lambda path: marked(path, own))
    curves = [read_curve(run / "metrics.csv", run.resolve().name) for run in folders]
    picture = draw_curves(curves, output, own)
    if json:
        print_json({"path": str(picture), "curves": [vars(each) for each in curves]})
    else:
        typer.echo(f"wrote {picture}")
