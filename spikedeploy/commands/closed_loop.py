"""`run`, `compare`, `reproduce`, `demo` and `serve`: policies that act in their environments."""

import shlex
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from spikedeploy import seeds
from spikedeploy.commands.options import (
    Computes,
    Damaged,
    OnChip,
    Reading,
    Switch,
    TablesChoice,
    TeacherUnits,
    World,
    one_word,
    with_groups,
)
from spikedeploy.console import print_json, print_result, say
from spikedeploy.runtime.errors import ConfigError

if TYPE_CHECKING:
    from spikedeploy.comparison.comparison import Comparison
    from spikedeploy.comparison.lineup import Entry
    from spikedeploy.realtime.paced_loop import PacedLoop
    from spikedeploy.shipping.cards import Settings
    from spikedeploy.shipping.hardware_run import CoreDriver, HardwareRun
    from spikedeploy.shipping.reproduce import Reproduction

# of which the numbers of an evaluation depend most
_PACKAGES = ("mujoco", "pymunk", "numpy", "onnxruntime", "torch")


@dataclass(frozen=True)
class ByTheClock:
    """Options for a closed loop in real time, and one that is watched."""

    rate: float | None = None
    deadline: str | None = None
    lasting: str | None = None
    watch: bool = False
    port: int | None = None

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
    *,
    policy: str,
    world: World,
    on_chip: OnChip,
    damaged: Damaged,
    reading: Reading,
    clock: ByTheClock,
    env: str | None = None,
    chip: str | None = None,
    episodes: int = 1,
    seed: int = seeds.EVALUATION,
    sampled: bool = False,
    video: Path | None = None,
    output: Path | None = None,
    energy: list[str] | None = None,
    native: bool = False,
    codec: Path | None = None,
    backend: Computes = "numpy",
    via: Path | None = None,
    tables: TablesChoice = "one",
    force: bool = False,
    json: bool = False,
) -> None:
    """Run one policy in its environment: returns, successes and costs.

    With --via: hardware in simulation drives, and exit code 1 says that it is not the chip's equal.
    """
    from spikedeploy.comparison.evaluation import run_policy
    from spikedeploy.comparison.metrics import checked_metrics
    from spikedeploy.outputs import check_output, has_text, mark
    from spikedeploy.runtime.metrics.energy import checked_table_names
    from spikedeploy.shipping.exported_run import runnable, trained_in

    if native:
        from spikedeploy.policies.native import permit

        permit(Path(policy))
    if video:
        check_output("--video", video, (policy,), force, lambda path: has_text(path, mark("run")))
    if output:
        if sampled:
            raise typer.BadParameter("-o replays greedy episodes: leave --sampled out")
        _check_output_folder(output, [policy], force)
    prices = checked_table_names(energy or ())
    metrics = checked_metrics(world.metric or ())
    clock.check(video is not None, episodes > 1)
    if via is not None:
        _check_via(via, chip, backend, native, (reading, on_chip, damaged, clock))
    policy = _adopt(policy, reading, codec, env, chip, on_chip, force)
    options, file, loop, drove = world.options(), runnable(policy), None, None
    play = partial(
        run_policy,
        file,
        env or trained_in(policy),
        seeds=range(seed, seed + episodes),
        sampled=sampled,
        options=options,
        metrics=metrics,
        faults=damaged.faults(),
        **on_chip.arguments(),
    )
    with _hardware(via, file) as core:
        if core is None:
            with clock.loop(prices) as loop:
                comparison = play(chip=chip, video=video, loop=loop, backend=backend)
        else:
            comparison = play(chip=core.chip, video=video, backend=core.backend, name=core.name)
            drove = core.beside_emulated(comparison, partial(play, chip=core.chip))
        document = _report(replace(comparison, tables=prices), options, output, loop, drove)
    from spikedeploy.reports.terminal import print_run  # after the first action, which is sooner

    _print(document, json, print_run, tables, output, video)
    if drove:
        for line in () if json else drove.lines():
            typer.echo(line)
        raise typer.Exit(0 if drove.equal else 1)


def _check_via(
    via: Path, chip: str | None, backend: str, native: bool, groups: tuple[object, ...]
) -> None:
    """Refuse options that an export has already decided, or that a simulation has no sense for."""
    given = {"--chip": chip, "--native": native or None, "--backend": backend != "numpy" or None}
    named = [name for name, value in given.items() if value is not None]
    if named or groups != (Reading(), OnChip(), Damaged(), ByTheClock()):
        what = named[0] if named else "options of reading, of the emulated chip and by the clock"
        raise ConfigError(
            f"--via {via}: the folder says what it was exported for, and a simulation is not by "
            f"the clock: leave {what} out"
        )


def _hardware(via: Path | None, policy: str) -> "AbstractContextManager[CoreDriver | None]":
    """The hardware of --via; None where there is none."""
    if via is None:
        return nullcontext()
    from spikedeploy.shipping.hardware_run import driver

    return driver(via, policy)


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
    # a network that no tool wrote is read by its dt
    if reading.from_ is None and (codec is None or reading.dt is None):
        stated = (*convention.items(), ("codec", codec))
        if given := [name for name, value in stated if value is not None]:
            raise typer.BadParameter(
                f"--{given[0]} goes with --from, or where no tool wrote the file with --codec and "
                "--dt: other policies state it"
            )
        return policy
    from spikedeploy.envs import spec
    from spikedeploy.policies.nir import adopt, check_fits

    if env is not None:
        spec(env)  # refuses an unknown one before a file is written
    check = partial(check_fits, chip, on_chip.limits == "on", on_chip.quantisation())
    return str(adopt(policy, codec, force, check, **convention))


def _check_output_folder(output: Path, inputs: Sequence[str], force: bool) -> None:
    from spikedeploy.outputs import check_output_folder
    from spikedeploy.reports import comparison as report

    check_output_folder("-o", output, report.FILES, inputs, force, report.is_report)


def _report(
    comparison: "Comparison",
    options: dict[str, Any],
    output: Path | None,
    loop: "PacedLoop | None" = None,
    drove: "HardwareRun | None" = None,
) -> dict[str, Any]:
    """The comparison as a document, which is written where there is a folder for it."""
    from spikedeploy.reports import comparison as report

    document = report.document(comparison)
    if loop:
        document["real_time"] = loop.measured().as_json()
    if drove:
        document["hardware"] = drove.as_json()
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

    if json:
        print_json(document)
        return
    print_document(document, tables == "all")
    for file in filter(None, (video, output and output / "report.html")):
        typer.echo(f"wrote {file}")


def compare(
    *,
    env: str,
    world: World,
    on_chip: OnChip,
    damaged: Damaged,
    files: list[str] | None = None,
    chip: list[str] | None = None,
    episodes: int = 20,
    seed: int = seeds.EVALUATION,
    teacher: str | None = None,
    teacher_units: TeacherUnits | None = None,
    energy: list[str] | None = None,
    via: Path | None = None,
    workers: int | None = None,
    output: Path | None = None,
    tables: TablesChoice = "one",
    force: bool = False,
    json: bool = False,
) -> None:
    """Compare policies on the same seeds: returns, agreement, spikes, operations, energy.

    With --via: hardware in simulation drives as well, in a row of its own.
    """
    from spikedeploy.comparison.evaluation import compare_policies, run_policy
    from spikedeploy.comparison.lineup import line_up, remark_on_chip
    from spikedeploy.comparison.metrics import checked_metrics
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
    entries = line_up(env, policies, split_names(",".join(chip)) if chip else None, taught, **on)
    for remark in filter(None, map(remark_on_chip, entries)):
        say(remark)
    options, drove = world.options(), None
    numbers = range(seed, seed + episodes)
    if via and (on_chip, damaged) != (OnChip(), Damaged()):
        raise ConfigError(f"--via {via}: leave options of the emulated chip out")
    exported = _exported_entry(via, entries) if via else ""
    comparison = compare_policies(env, entries, numbers, workers, options, metrics)
    if via:
        play = partial(
            run_policy, exported, env, seeds=numbers, options=options, metrics=metrics, **on
        )
        with _hardware(via, exported) as core:
            if core is not None:
                played = play(chip=core.chip, backend=core.backend, name=core.name)
                places = [(str(r.entry.candidate.path), r.entry.chip) for r in comparison.rows]
                emulated: Callable[[], Comparison] = partial(play, chip=core.chip)
                if (place := (exported, core.chip)) in places:  # those episodes were played
                    rows = [comparison.rows[places.index(place)]]
                    emulated = partial(replace, comparison, rows=rows)
                drove = core.beside_emulated(played, emulated)
                comparison = replace(comparison, rows=[*comparison.rows, *played.rows])
    document = _report(replace(comparison, tables=prices), options, output, drove=drove)
    _print(document, json, print_comparison, tables, output)
    if drove:
        for line in () if json else drove.lines():
            typer.echo(line)
        raise typer.Exit(0 if drove.equal else 1)


def _exported_entry(via: Path, entries: "Sequence[Entry]") -> str:
    """The file among the policies that the folder of --via was exported from."""
    from spikedeploy import zoo
    from spikedeploy.shipping.verilog_folder import read_folder

    found = read_folder(via)
    for entry in entries:
        if (
            entry.candidate.format == ".nir"
            and zoo.sha256(Path(entry.candidate.path)) == found.sha256
        ):
            return str(entry.candidate.path)
    raise ConfigError(
        f"--via {via} was exported from {found.policy}, which is none of the policies that are "
        "compared: name it beside them"
    )


def demo(
    *,
    tables: TablesChoice = "one",
    show: bool = True,
    force: bool = False,
    json: bool = False,
) -> None:
    """Replay shipped policies on an emulated Loihi beside float ones: a page with their spikes."""
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
    *,
    policy: str,
    chip: str | None = None,
    port: int = 5555,
    address: str = "127.0.0.1",
    clients: int = 32,
    idle: str = "60s",
    limits: Switch = "on",
    backend: Computes = "numpy",
    json: bool = False,
) -> None:
    """Answer observations with actions over ZeroMQ, on this machine."""
    import threading

    from spikedeploy.realtime.paced_loop import duration
    from spikedeploy.realtime.server import PolicyServer, ServedPolicy
    from spikedeploy.shipping.exported_run import runnable

    forgotten = duration("--idle", idle)
    served = ServedPolicy(runnable(policy), chip, backend, limits == "on")
    server = PolicyServer(served, address, port, clients, forgotten)
    if address != "127.0.0.1":
        say(f"warning: {address} is open to other machines, and nothing is authenticated")
    line = f"serving {served.name} on {served.chip} at {server.endpoint}"
    print_result(json, {"endpoint": server.endpoint, **served.info()}, line)
    try:
        server.serve(threading.Event())
    finally:
        server.close()


def reproduce(
    *,
    names: list[str] | None = None,
    episodes: int | None = None,
    env: str | None = None,
    update: bool = False,
    force: bool = False,
    workers: int | None = None,
    json: bool = False,
) -> None:
    """Evaluate policies again as recorded; say equal or the first difference, and exit 1 then."""
    from spikedeploy import zoo
    from spikedeploy.make_env import confirm
    from spikedeploy.shipping import reproduce as again
    from spikedeploy.shipping.cards import read_evaluation

    evaluations = [read_evaluation(name, settings) for name in names or ()] or [
        replace(read_evaluation(str(zoo.path(name)), settings), name=name) for name in zoo.names()
    ]
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
    given: dict[str, Any] = {}
    app = typer.Typer(add_completion=False)
    app.command(context_settings={"token_normalize_func": one_word})(
        with_groups(compare, call=given.update)
    )
    try:
        typer.main.get_command(app)(words, standalone_mode=False)
    except Exception as error:  # click's, of which typer has a copy of its own
        raise ConfigError(f"the report's command {command!r} is not understood: {error}") from error
    if not given:  # it has --help
        raise ConfigError(f"the report's command {command!r} compares nothing")
    return given


def _lines(found: "Reproduction") -> list[str]:
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
