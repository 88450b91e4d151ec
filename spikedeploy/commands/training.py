"""`train`, `visualize`, `export` and `publish`: from a recipe to a shipped policy."""

import shlex
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Any

import typer

from spikedeploy import seeds
from spikedeploy.commands.options import Force, Json, States, Workers
from spikedeploy.commands.training_seeds import run_seeds

Checkpoint = Annotated[
    str | None,
    typer.Option(
        metavar="NAME",
        help="Checkpoint of the run, such as last or ops-480.",
        show_default="best, else last",
    ),
]

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
    json: Json = False,
) -> None:
    """Train a policy. Ctrl-C stops at a checkpoint; --resume last goes on."""
    if what is None and (resume is None or recipe is not None):
        raise typer.BadParameter("name a RECIPE, an ENV with --recipe, or a run with --resume")
    settings: dict[str, Any] = {
        "env": what if recipe else None,
        "config_file": config,
        "overrides": set_ or (),
        "budget": budget,
    }
    if several is not None:
        if seed is not None or resume is not None:
            raise typer.BadParameter("--seeds goes without --seed and --resume")
        run_seeds(several, jobs, json, runs, recipe or what, **settings)
    if jobs is not None:
        raise typer.BadParameter("--jobs goes with --seeds")
    run_training(recipe or what, json, seed=seed, resume=resume, runs=runs, **settings)


def run_training(
    recipe: str | None,
    json: bool,
    *,
    seed: int | None,
    resume: str | None,
    runs: Path,
    remark: Callable[[Path], str] = lambda run: "",
    **settings: Any,  # noqa: ANN401
) -> None:
    """Train; print where the run is, and what to do next; stopped by a signal, exit with its code.

    remark    line on a training that ended
    settings  more arguments of trainers.train.train
    """
    if resume is not None and seed is not None:
        raise typer.BadParameter("a resumed run keeps its seed: leave --seed out")
    from spikedeploy.console import print_json, say
    from spikedeploy.pages.training import LivePage
    from spikedeploy.shipping.exported_run import trained_in
    from spikedeploy.trainers.interrupt import Interrupt
    from spikedeploy.trainers.train import train as learn

    interrupt, more = Interrupt(), {"seed": seed or 0, "resume": resume, "runs": runs, **settings}
    run = learn(recipe, quiet=json, interrupt=interrupt, watch=LivePage(), **more)
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
        again = shlex.join(["spikedeploy", "compare", str(env), str(run)])
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


def export(
    run: Annotated[
        str,
        typer.Argument(
            metavar="RUN", help="Run folder, its name under runs/, or 'last'; for c also FILE.nir."
        ),
    ],
    to: Annotated[
        str | None,
        typer.Option(
            help="Format: nir or c for spiking policies, onnx for float ones; or card.",
            show_default="as -o ends, else as the policy is",
        ),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option(
            "-o",
            "--output",
            help="File to write; for c the folder.",
            show_default="in the run folder",
        ),
    ] = None,
    observations: Annotated[
        int, typer.Option(min=1, help="Recorded observations on which file and policy must agree.")
    ] = 1000,
    chip: Annotated[str, typer.Option(help="Chip whose integers are written; c only.")] = "loihi1",
    prefix: Annotated[str, typer.Option(help="What names begin with; c only.")] = "policy",
    state: Annotated[
        States | None,
        typer.Option(
            help="Membranes at an inference: reset, or kept; nir only.", show_default="as trained"
        ),
    ] = None,
    checkpoint: Checkpoint = None,
    film: Annotated[
        bool, typer.Option("--film", help="With --to card: replay.mp4 of one greedy episode.")
    ] = False,
    force: Force = False,
    json: Json = False,
) -> None:
    """Write a trained policy as .nir or .onnx, and check the file against it; or as C99.

    --to card makes the run folder ready for upload: the policy, card.md, curve.svg, report.html.
    """
    if film and to != "card":
        raise typer.BadParameter("--film goes with --to card")
    if to == "c":
        _export_c(run, chip, output, observations, prefix, force, json)
        return
    if to == "card":
        _export_card(run, output, checkpoint, film, force, json)
        return
    from spikedeploy.console import print_json, say
    from spikedeploy.reports.terminal import print_checks
    from spikedeploy.shipping.export_run import export_run

    written = export_run(
        run, to, output, observations, state=state, checkpoint=checkpoint, force=force
    )
    if json:
        checks = [vars(check) for check in written.checks]
        print_json({"path": str(written.path), "passed": written.passed, "checks": checks})
    else:
        print_checks(written.checks)
        typer.echo(f"wrote {written.path}")
        if written.unfinished:
            say(f"its training is unfinished: stopped at {written.unfinished}")
    raise typer.Exit(0 if written.passed else 1)


def _export_c(
    policy: str,
    chip: str,
    folder: Path | None,
    observations: int,
    prefix: str,
    force: bool,
    json: bool,
) -> None:
    """Write a policy as C of a chip, and say what that takes."""
    from spikedeploy.console import print_json
    from spikedeploy.shipping.export_c import export_c

    written = export_c(policy, chip, folder, observations, prefix, force)
    if json:
        print_json(written.record())
        return
    for line in written.lines():
        typer.echo(line)


def _export_card(
    run: str, output: Path | None, checkpoint: str | None, film: bool, force: bool, json: bool
) -> None:
    """Write what shows a run beside its policy into its folder, and say what."""
    from spikedeploy.console import print_json
    from spikedeploy.shipping.run_card import export_card

    if output is not None or checkpoint is not None:
        raise typer.BadParameter("--to card is of the run folder: leave -o and --checkpoint out")
    files = export_card(run, film, force)
    if json:
        print_json({"files": [str(file) for file in files]})
    else:
        typer.echo("wrote " + ", ".join(str(file) for file in files))


def publish(
    run: Annotated[
        str, typer.Argument(metavar="RUN", help="Run folder, its name under runs/, or 'last'.")
    ],
    name: Annotated[str, typer.Option(help="Name in the zoo, such as popsan.")],
    episodes: Annotated[int, typer.Option(min=1, help="Episodes of the card's evaluation.")] = 100,
    note: Annotated[str, typer.Option(help="Note for the card.")] = "",
    control: Annotated[
        bool, typer.Option("--control", help="Comparisons show it as a control.")
    ] = False,
    checkpoint: Checkpoint = None,
    workers: Workers = None,
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", help="Folder of the zoo.", show_default="the package's own"),
    ] = None,
    force: Force = False,
    json: Json = False,
) -> None:
    """Export a run into the zoo: the file, its card, its learning curve and its evaluation."""
    from spikedeploy import zoo
    from spikedeploy.console import print_json
    from spikedeploy.shipping.publish_run import publish_run

    folder = output or zoo.FOLDER
    files = publish_run(run, name, episodes, folder, workers, note, control, checkpoint, force)
    if json:
        print_json({"files": [str(file) for file in files]})
    else:
        typer.echo("wrote " + ", ".join(str(file) for file in files))


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
    from spikedeploy.reports.curves import curve
    from spikedeploy.reports.plots import draw_curves
    from spikedeploy.trainers.run_names import existing_run

    own = mark("visualize")
    folders = [Path(run) if Path(run).is_dir() else existing_run(run) for run in runs]
    check_output("-o", output, folders, force, lambda path: marked(path, own))
    curves = [curve(run / "metrics.csv", run.resolve().name) for run in folders]
    picture = draw_curves(curves, output, own)
    if json:
        print_json({"path": str(picture), "curves": [vars(each) for each in curves]})
    else:
        typer.echo(f"wrote {picture}")
