"""`train`, `distill`, `tune`, `sweep`, `runs` and `visualize`: from a recipe to run folders."""

import shlex
from collections.abc import Callable
from contextlib import suppress
from json import dumps
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from spikedeploy import seeds
from spikedeploy.commands.options import Encoders, Force, Json, Settings, Workers

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
        _run_seeds(several, jobs, json, runs, recipe or what, films=films, **settings)
    if jobs is not None:
        raise typer.BadParameter("--jobs goes with --seeds")
    _run_training(
        recipe or what, json, seed=seed, resume=resume, runs=runs, films=films, **settings
    )


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


def _run_training(
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
    """Write page, card and curves; a failure here does not affect the training."""
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


def _run_seeds(
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
    numbers = training_seeds("--seeds", text)
    count = min(jobs or cores(), len(numbers))
    file = str(config_file) if config_file else None
    arguments = {"recipe": recipe, "config_file": file, "runs": str(runs), **settings}
    say(f"{len(numbers)} trainings, {count} at a time; logs in {runs / 'logs'}")
    found = train_seeds(numbers, count, runs / "logs", arguments, lambda each: say(each.line))
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
            print_text(f"mean {mean.mean:,.4g}{between if len(numbers) > 1 else ''}")
    if found.interrupted:
        for each in found.each:
            if each.run and each.stopped:
                say(f"go on with `spikedeploy train --resume {each.run}`")
        raise typer.Exit(130)
    raise typer.Exit(1 if any(each.failed for each in found.each) else 0)


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
    set_: Settings = None,
    seed: TrainingSeed = None,
    resume: Resume = None,
    runs: Runs = Path("runs"),
    json: Json = False,
) -> None:
    """Train a spiking student that imitates a teacher. A function of yours runs as your code."""
    if resume is None and (teacher is None or env is None):
        raise typer.BadParameter("name a TEACHER and --env ENV, or a run with --resume")
    from spikedeploy.commands.distillation import earned, student_settings, teacher_options

    recipe, settings = student_settings(teacher, size, encoder, timesteps, budget is not None, chip)
    _run_training(
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


# as the table BACKENDS of spikedeploy.jobs has them; a test holds both together
BackendName = Literal["serial", "process", "ray"]


def sweep(
    spec: Annotated[
        Path,
        typer.Argument(
            metavar="SPEC.toml",
            exists=True,
            dir_okay=False,
            help="The grid: env, policy, chip, bits, disturb, fault, specimen, seed; "
            "docs/sweeps.md.",
        ),
    ],
    backend: Annotated[
        BackendName,
        typer.Option(help="This process, several of one thread each, or tasks of Ray."),
    ] = "process",
    workers: Workers = None,
    address: Annotated[
        str | None,
        typer.Option(
            metavar="HOST:PORT",
            help="With --backend ray: a cluster that is running; 'auto' for that of this machine.",
            show_default="Ray is started here, and ended",
        ),
    ] = None,
    retry: Annotated[
        bool, typer.Option("--retry", help="Run those again that failed, too.")
    ] = False,
    run: Annotated[
        bool, typer.Option(help="Run missing jobs; --no-run only shows what is there.")
    ] = True,
    output: Annotated[
        Path | None,
        typer.Option(
            "-o", "--output", help="Folder of the results.", show_default="runs/sweeps/NAME"
        ),
    ] = None,
    force: Force = False,
    json: Json = False,
) -> None:
    """Evaluate a grid of policies, chips, disturbances and seeds; run again, it goes on."""
    from spikedeploy import jobs
    from spikedeploy.campaign.sweep import is_sweep, load_sweep, run_sweep
    from spikedeploy.campaign.sweep_grid import read_grid
    from spikedeploy.campaign.sweep_page import NUMBERS, PAGE, SHOWN, print_sweep
    from spikedeploy.console import print_json, say
    from spikedeploy.outputs import check_output_folder

    grid = read_grid(spec)
    folder = output or Path("runs/sweeps") / grid.name
    check_output_folder(
        "-o", folder, (PAGE, SHOWN, NUMBERS, "journal.csv"), (spec,), force, is_sweep
    )
    chosen = jobs.backend(backend, workers, address)
    found = run_sweep(grid, folder, chosen, retry) if run else load_sweep(grid, folder)
    if json:
        print_json(found.as_json() | {"folder": str(folder), "ran": found.ran})
    else:
        print_sweep(found)
        for label, why in found.failures:
            typer.echo(f"failed: {label}: {why}", err=True)
        typer.echo(f"{found.summary}: {found.files[0]}")
    if found.interrupted:
        say("stopped; the same command goes on")
        raise typer.Exit(130)
    raise typer.Exit(1 if found.failed else 0)


# fields of RunScores; a test holds them together
SortKey = Literal["return", "success", "operations", "share", "age", "name"]


def runs(
    folder: Annotated[
        Path, typer.Option("--runs", help="Folder with the run folders; also those below it.")
    ] = Path("runs"),
    sort: Annotated[
        SortKey, typer.Option(help="Column to sort by; the best, newest or first are on top.")
    ] = "age",
    env: Annotated[
        str | None, typer.Option(help="Only of this environment.", show_default="all")
    ] = None,
    json: Json = False,
) -> None:
    """List training runs: validation return, success, operations, how far each came, age."""
    from spikedeploy.console import name_program, print_json
    from spikedeploy.reports.runs import find_runs, run_table

    rows, damaged = find_runs(folder, env, sort)
    if json:
        print_json([row.as_json() for row in rows])
    elif rows:
        run_table(rows, folder).print()
    else:
        typer.echo(name_program(f"no runs in {folder}: `spikedeploy train RECIPE` makes one"))
    for line in damaged:
        typer.echo(f"left out: {line}", err=True)
