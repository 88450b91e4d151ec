"""`run`, `compare`, `reproduce`, `demo` and `serve`: policies that act in their environments."""

import shlex
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from spikedeploy import seeds
from spikedeploy.commands.options import (
    Backend,
    Damaged,
    Energy,
    Force,
    Json,
    LimitsOption,
    OnChip,
    PolicyChip,
    Reading,
    Seed,
    Tables,
    TeacherUnits,
    Workers,
    World,
    with_groups,
)

if TYPE_CHECKING:
    from spikedeploy.comparison.comparison import Comparison
    from spikedeploy.realtime.paced_loop import PacedLoop
    from spikedeploy.shipping.cards import Settings
    from spikedeploy.shipping.reproduce import Reproduction

_clock = partial(typer.Option, rich_help_panel="By the clock")
# of which the numbers of an evaluation depend most
_PACKAGES = ("mujoco", "pymunk", "numpy", "onnxruntime", "torch")


@dataclass(frozen=True)
class ByTheClock:
    """Options for a closed loop in real time, and one that is watched."""

    rate: Annotated[
        float | None,
        _clock(
            help=r"Control steps per second \[Hz] by the clock; missed deadlines are counted.",
            show_default="as fast as it can",
        ),
    ] = None
    deadline: Annotated[
        str | None,
        _clock(
            metavar="TIME",
            help="With --rate: 20ms; of a control step.",
            show_default="the period",
        ),
    ] = None
    lasting: Annotated[
        str | None,
        _clock(
            "--duration",
            metavar="TIME",
            help="With --rate: 60s; episodes are played until it has passed, the last to its end.",
        ),
    ] = None
    watch: Annotated[
        bool,
        _clock(
            "--watch",
            help="Show robot, spikes, energy, deadlines in a browser of this machine.",
        ),
    ] = False
    port: Annotated[
        int | None,
        _clock(
            min=1,
            max=65535,
            help="With --watch: TCP port.",
            show_default="one that is free",
        ),
    ] = None

    def check(self, film: bool, several: bool) -> None:
        """Refuse combinations that mean nothing."""
        if film and (self.watch or self.rate is not None):
            by = "--watch" if self.watch else "--rate"
            raise typer.BadParameter(f"{by} is by the clock, and a film is not: leave --video out")
        if self.lasting and several:
            raise typer.BadParameter(
                "--duration plays as many episodes as fit: leave --episodes out"
            )
        if self.port is not None and not self.watch:
            raise typer.BadParameter("--port goes with --watch")

    def loop(self, tables: Sequence[str]) -> "AbstractContextManager[PacedLoop | None]":
        """The loop by --watch or by --rate; None, which plays as fast as it can."""
        pace = self.rate, self.deadline, self.lasting
        if self.watch:
            from spikedeploy.live import watched_loop

            return watched_loop(self.port, *pace, tables)
        from spikedeploy.realtime.paced_loop import PacedLoop, pacing

        found = pacing(*pace)
        return nullcontext(PacedLoop(found) if found else None)


def run(
    policy: Annotated[
        str, typer.Argument(metavar="FILE", help="A .onnx or .nir file, run folder, shipped name.")
    ],
    world: World,
    on_chip: OnChip,
    damaged: Damaged,
    reading: Reading,
    clock: ByTheClock,
    env: Annotated[
        str | None,
        typer.Option(
            help="Environment: short name, id of gymnasium, or module:Class.",
            show_default="the one it was made for",
        ),
    ] = None,
    chip: PolicyChip = None,
    episodes: Annotated[int, typer.Option(min=1, help="Episodes.")] = 1,
    seed: Seed = seeds.EVALUATION,
    sampled: Annotated[
        bool,
        typer.Option("--sampled", help="Draw actions by their probability, not the likeliest."),
    ] = False,
    video: Annotated[Path | None, typer.Option(help="MP4 of the first episode.")] = None,
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", help="Folder for report.html, which replays episodes."),
    ] = None,
    energy: Energy = None,
    native: Annotated[
        bool,
        typer.Option("--native", help="FILE is a .so that you built; its code runs as you."),
    ] = False,
    codec: Annotated[
        Path | None,
        typer.Option(
            exists=True,
            dir_okay=False,
            help="With --from: .json, how observations become spikes and output actions.",
        ),
    ] = None,
    backend: Backend = "numpy",
    shown: Tables = "one",
    force: Force = False,
    json: Json = False,
) -> None:
    """Run one policy in its environment: returns, successes and costs."""
    from spikedeploy.comparison.evaluation import run_policy
    from spikedeploy.comparison.metrics import checked_metrics
    from spikedeploy.outputs import check_output, mark, marked
    from spikedeploy.runtime.metrics.energy import checked_table_names
    from spikedeploy.shipping.exported_run import runnable, trained_in

    if native:
        from spikedeploy.policies.native import permit

        permit(Path(policy))
    if video:
        check_output("--video", video, (policy,), force, lambda path: marked(path, mark("run")))
    if output:
        if sampled:
            raise typer.BadParameter("-o replays greedy episodes: leave --sampled out")
        _check_output_folder(output, [policy], force)
    tables = checked_table_names(energy or ())
    metrics = checked_metrics(world.metric or ())
    clock.check(video is not None, episodes > 1)
    policy = _adopt(policy, reading, codec, env, chip, on_chip, force)
    options = world.options()
    with clock.loop(tables) as loop:
        comparison = run_policy(
            runnable(policy),
            env or trained_in(policy),
            chip,
            range(seed, seed + episodes),
            video,
            sampled,
            options,
            metrics,
            loop,
            faults=damaged.faults(),
            backend=backend,
            **on_chip.arguments(),
        )
    document = _report(replace(comparison, tables=tables), options, output, loop)
    from spikedeploy.reports.terminal import print_run  # after the first action, which is sooner

    _print(document, json, print_run, shown, output, video)


def _adopt(
    policy: str,
    reading: Reading,
    codec: Path | None,
    env: str | None,
    chip: str | None,
    on_chip: OnChip,
    force: bool,
) -> str:
    """The policy, or the one that is written from a file of another tool."""
    convention = reading.arguments()
    if reading.from_ is None:
        given = [
            name for name, value in (*convention.items(), ("codec", codec)) if value is not None
        ]
        if given:
            raise typer.BadParameter(f"--{given[0]} goes with --from: other policies state it")
        return policy
    from spikedeploy.envs import spec
    from spikedeploy.policies.nir import adopt, check_fits

    if env is not None:
        spec(env)  # refuses an unknown one before a file is written
    check = partial(check_fits, chip, on_chip.limits == "on", on_chip.quantisation())
    return str(adopt(policy, codec, force, check, **convention))


def _check_output_folder(output: Path, inputs: Sequence[str], force: bool) -> None:
    """Refuse a folder whose files are not those of a report."""
    from spikedeploy.outputs import check_output_folder
    from spikedeploy.reports import comparison as report

    check_output_folder("-o", output, report.FILES, inputs, force, report.is_report)


def _report(
    comparison: "Comparison",
    options: dict[str, Any],
    output: Path | None,
    loop: "PacedLoop | None" = None,
) -> dict[str, Any]:
    """The comparison as a document, which is written where there is a folder for it."""
    from spikedeploy.reports import comparison as report

    document = report.document(comparison)
    if loop:
        document["real_time"] = loop.measured().as_json()
    if output:
        recorded = report.recordings(comparison, document["rows"], options)
        report.write(document, output, episodes=recorded)
    return document


def _print(
    document: dict[str, Any],
    json: bool,
    print_document: Callable[[dict[str, Any], bool], None],
    tables: str,
    output: Path | None,
    video: Path | None = None,
) -> None:
    from spikedeploy.console import print_json

    if json:
        print_json(document)
        return
    print_document(document, tables == "all")
    for file in filter(None, (video, output and output / "report.html")):
        typer.echo(f"wrote {file}")


def compare(
    env: Annotated[
        str,
        typer.Argument(
            metavar="ENV",
            help="Environment; `envs` lists ours; or an id of gymnasium, or module:Class.",
        ),
    ],
    world: World,
    on_chip: OnChip,
    damaged: Damaged,
    files: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[FILE]…",
            help="Policies: .onnx, .nir, run folders, shipped names. The float ANN, the "
            "built-in players and the controls are added.",
            show_default="all that are shipped",
        ),
    ] = None,
    chips: Annotated[
        list[str] | None,
        typer.Option(
            help="Chips for the spiking policies, separated by commas, or the option again.",
            show_default="what each was trained for, else loihi1",
        ),
    ] = None,
    episodes: Annotated[int, typer.Option(min=1, help="Episodes of each row.")] = 20,
    seed: Seed = seeds.EVALUATION,
    teacher: Annotated[
        str | None,
        typer.Option(
            metavar="TEACHER",
            help="A row for a teacher, as `distill` takes it; a function of yours runs as your "
            "code.",
        ),
    ] = None,
    teacher_units: Annotated[
        TeacherUnits | None,
        typer.Option(help="Units of its actions.", show_default="those of its kind"),
    ] = None,
    energy: Energy = None,
    workers: Workers = None,
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", help="Folder for report.json, report.html and plots."),
    ] = None,
    tables: Tables = "one",
    force: Force = False,
    json: Json = False,
) -> None:
    """Compare policies on the same seeds: returns, agreement, spikes, operations, energy."""
    from spikedeploy.comparison.evaluation import compare_policies
    from spikedeploy.comparison.lineup import line_up, remark_on_chip
    from spikedeploy.comparison.metrics import checked_metrics
    from spikedeploy.console import say
    from spikedeploy.policies.scripts import teacher_candidate
    from spikedeploy.reports.terminal import print_comparison
    from spikedeploy.runtime.chips.chip import split_names
    from spikedeploy.runtime.metrics.energy import checked_table_names
    from spikedeploy.shipping.exported_run import runnable

    if teacher_units and teacher is None:
        raise typer.BadParameter("--teacher-units goes with --teacher")
    if output:
        _check_output_folder(output, [*(files or ()), *([teacher] if teacher else ())], force)
    prices = checked_table_names(energy or ())
    metrics = checked_metrics(world.metric or ())
    on = {"faults": damaged.faults(), **on_chip.arguments()}
    policies = [runnable(file) for file in files or ()]
    taught = teacher_candidate(runnable(teacher), teacher_units) if teacher else None
    entries = line_up(env, policies, split_names(",".join(chips)) if chips else None, taught, **on)
    for remark in filter(None, map(remark_on_chip, entries)):
        say(remark)
    options = world.options()
    numbers = range(seed, seed + episodes)
    comparison = compare_policies(env, entries, numbers, workers, options, metrics)
    document = _report(replace(comparison, tables=prices), options, output)
    _print(document, json, print_comparison, tables, output)


def demo(
    tables: Tables = "one",
    show: Annotated[
        bool, typer.Option("--open/--no-open", help="Open the page, where there is a desktop.")
    ] = True,
    force: Force = False,
    json: Json = False,
) -> None:
    """Replay shipped policies on an emulated Loihi beside float ones: a page with their spikes."""
    from spikedeploy.console import print_json
    from spikedeploy.play.display import has_desktop
    from spikedeploy.shipping.demo_reports import FOLDER, write_demo

    documents = write_demo(quiet=json, everything=tables == "all", force=force)
    index = FOLDER / "index.html"
    if json:
        print_json({"folder": str(FOLDER), "reports": documents})
    elif documents:
        typer.echo(f"wrote {index}: open it in a browser")
        if show and has_desktop():
            typer.launch(str(index))


def serve(
    policy: Annotated[
        str, typer.Argument(metavar="FILE", help="A .nir file, run folder, shipped name.")
    ],
    chip: PolicyChip = None,
    port: Annotated[
        int, typer.Option(min=0, max=65535, help="TCP port; 0 for one that is free.")
    ] = 5555,
    address: Annotated[
        str,
        typer.Option(
            help="IPv4 address to listen on. Nothing is authenticated: any other than 127.0.0.1 "
            "lets whoever reaches it drive the policy."
        ),
    ] = "127.0.0.1",
    clients: Annotated[int, typer.Option(min=1, max=1024, help="Most clients at a time.")] = 32,
    idle: Annotated[
        str, typer.Option(metavar="TIME", help="A client that is silent so long is forgotten.")
    ] = "60s",
    limits: LimitsOption = "on",
    backend: Backend = "numpy",
    json: Json = False,
) -> None:
    """Answer observations with actions over ZeroMQ, on this machine."""
    import threading

    from spikedeploy.console import print_json, say
    from spikedeploy.realtime.paced_loop import duration
    from spikedeploy.realtime.server import PolicyServer, ServedPolicy
    from spikedeploy.shipping.exported_run import runnable

    forgotten = duration("--idle", idle)
    served = ServedPolicy(runnable(policy), chip, backend, limits == "on")
    server = PolicyServer(served, address, port, clients, forgotten)
    if address != "127.0.0.1":
        say(f"warning: {address} is open to other machines, and nothing is authenticated")
    if json:
        print_json({"endpoint": server.endpoint, **served.info()})
    else:
        typer.echo(f"serving {served.name} on {served.chip} at {server.endpoint}")
    try:
        server.serve(threading.Event())
    finally:
        server.close()


def reproduce(
    names: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[NAME]…",
            help="Shipped policies, paths of cards, folders with a report.json of `compare`.",
            show_default="all shipped policies",
        ),
    ] = None,
    episodes: Annotated[
        int | None, typer.Option(min=1, help="Only the first seeds.", show_default="all recorded")
    ] = None,
    env: Annotated[
        str | None,
        typer.Option(
            metavar="module:Class",
            help="Environment of your own that a record names, whose code may be run.",
        ),
    ] = None,
    update: Annotated[
        bool,
        typer.Option(
            "--update", help="Write the numbers found into cards, where all returns are equal."
        ),
    ] = False,
    force: Force = False,
    workers: Workers = None,
    json: Json = False,
) -> None:
    """Evaluate policies again as recorded; say equal or the first difference, and exit 1 then."""
    from spikedeploy import zoo
    from spikedeploy.console import print_json
    from spikedeploy.make_env import confirm
    from spikedeploy.shipping import reproduce as again
    from spikedeploy.shipping.cards import recorded

    evaluations = [recorded(name, settings) for name in names or zoo.names()]
    for evaluation in evaluations:  # before hours of others
        confirm(evaluation.env, env, evaluation.name)
        again.check_episodes(evaluation, episodes or 1)
    found = []
    for evaluation in evaluations:
        found.append(again.reproduce(evaluation, episodes, workers, update, force))
        if not json:
            typer.echo("\n".join(_lines(found[-1])))
    if json:
        print_json([each.as_json() for each in found])
    raise typer.Exit(0 if update or all(each.equal for each in found) else 1)


def settings(command: str) -> "Settings":
    """The settings that a report's command gives, read as `compare` reads it today."""
    from spikedeploy.runtime.errors import ConfigError
    from spikedeploy.shipping.cards import Settings

    _, verb, *words = [*shlex.split(command), "", ""]
    if verb == "demo":
        return Settings()
    if verb != "compare":
        raise ConfigError(f"the report's command is {command!r}, and not `spikedeploy compare`")
    given = _parse(command, [word for word in words if word])
    if given["teacher"]:  # which may be code, and no file has that run
        raise ConfigError(
            f"the report has a row of the teacher {given['teacher']}, which a report does not have "
            "played: run its command again instead"
        )
    world: World = given["world"]
    return Settings(
        world.options(),
        given["on_chip"].quantisation(),
        given["damaged"].faults(),
        tuple(given["energy"] or ()),
        tuple(world.metric or ()),
    )


def _parse(command: str, words: list[str]) -> dict[str, Any]:
    """The parameters of a `compare`."""
    from spikedeploy.runtime.errors import ConfigError

    given: dict[str, Any] = {}
    app = typer.Typer(add_completion=False)
    app.command()(with_groups(compare, call=given.update))
    try:
        typer.main.get_command(app)(words, standalone_mode=False)
    except Exception as error:  # click's, of which typer has a copy of its own
        raise ConfigError(f"the report's command {command!r} is not understood: {error}") from error
    if not given:  # it has --help
        raise ConfigError(f"the report's command {command!r} compares nothing")
    return given


def _lines(found: "Reproduction") -> list[str]:
    """Lines for a terminal."""
    some = f"{found.episodes} of {found.of}" if found.episodes < found.of else f"{found.of}"
    lines = [
        f"{'✓' if found.equal else '✗'} {found.name}: {found.verdict} "
        f"({found.numbers:,} numbers, {some} episodes of {found.rows} rows, {found.seconds:g} s)"
    ]
    if found.difference:
        lines.append(f"    first of {found.differing}: {found.difference.describe()}")
        lines += [  # those that may matter, and all that differ
            f"    {name} {then or 'not installed'} then, {now or 'not installed'} now"
            for name, (then, now) in found.versions.items()
            if name in _PACKAGES or then != now
        ]
    if found.not_compared:
        lines.append(
            f"    not compared: {len(found.not_compared)} fields that are of all {found.of} "
            f"episodes: {', '.join(found.not_compared[:3])}… (--json names all)"
        )
    return lines + [f"    not recorded: {each}" for each in found.not_recorded]
