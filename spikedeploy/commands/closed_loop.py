"""`run`, `compare`, `play`, `demo`, `serve`, `reproduce`: policies act in their environments."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from spikedeploy.commands.options import (
    ChipName,
    EnvArgument,
    EnvName,
    EnvOptions,
    File,
    Folder,
    Force,
    Json,
    Limits,
    OutputPath,
    PolicyName,
    PolicyNames,
    Seed,
    Tables,
    Workers,
)
from spikedeploy.console import print_json, print_result, say
from spikedeploy.evaluation_setup import Count, OnChip, Reading, Setup, changed
from spikedeploy.runtime.choices import BackendName, Units
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.seeds import EVALUATION

if TYPE_CHECKING:
    from spikedeploy.comparison.comparison import Comparison
    from spikedeploy.realtime.paced_loop import PacedLoop
    from spikedeploy.shipping.reproduce import Reproduction
    from spikedeploy.shipping.verilog import CoreDriver

# of which the numbers of an evaluation depend most
_PACKAGES = ("mujoco", "pymunk", "numpy", "onnxruntime", "torch")


@dataclass(frozen=True)
class ByTheClock:
    """Options for a closed loop in real time, and one that is watched.

    By the clock:
        rate: control steps per second [Hz] by the clock; missed deadlines are counted (default: as
            fast as it can)
        deadline: with --rate: 20ms; time of a control step (default: the period)
        lasting: with --rate: 60s; episodes are played until it has passed, the last to its end
        watch: show robot, spikes, energy, deadlines in a browser of this machine
        port: with --watch: TCP port (default: one that is free)
    """

    rate: float | None = None
    deadline: Annotated[str, typer.Option(metavar="TIME")] | None = None
    lasting: Annotated[str, typer.Option("--duration", metavar="TIME")] | None = None
    watch: bool = False
    port: Annotated[int, typer.Option(min=1, max=65535)] | None = None

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
        if pace == (None, None, None):
            return nullcontext()
        from spikedeploy.realtime.paced_loop import PacedLoop, pacing

        found = pacing(*pace)
        return nullcontext(PacedLoop(found) if found else None)


def run(
    *,
    policy: PolicyName,
    setup: Setup,
    reading: Reading,
    clock: ByTheClock,
    env: EnvName | None = None,
    chip: ChipName | None = None,
    episodes: Count = 1,
    seed: Seed = EVALUATION,
    video: Path | None = None,
    output: OutputPath | None = None,
    native: bool = False,
    codec: File | None = None,
    via: Folder | None = None,
    tables: Tables = "one",
    force: Force = False,
    json: Json = False,
) -> None:
    """Run one policy in its environment: returns, successes and costs.

    With --via: hardware in simulation drives, and exit code 1 says that it is not the chip's equal.

    policy: a .onnx or .nir file, run folder, shipped name
    env: short name, id of gymnasium, or module:Class (default: the one it was made for)
    episodes: episodes to play

    Output:
        video: MP4 of the first episode
        output: folder for report.html, which replays episodes

    Hardware and code of yours:
        native: FILE is a .so that you built; its code runs as you
        via: let the core that `export --to verilog` wrote there drive, in simulation, and compare
            it with the emulated chip; what is in FOLDER runs as you

    How FILE is read:
        codec: with --from: .json, how observations become spikes and output actions
    """
    from spikedeploy.comparison.evaluation import run_policy
    from spikedeploy.outputs import check_output, has_text, mark
    from spikedeploy.shipping.exported_run import runnable, trained_in

    if native:
        from spikedeploy.policies.native import permit

        permit(Path(policy))
    if video:
        check_output("--video", video, (policy,), force, lambda path: has_text(path, mark("run")))
    if output:
        _check_output_folder(output, [policy], force, setup)
    setup.check()
    clock.check(video is not None, episodes > 1)
    if via is not None:
        _check_via(via, {"chip": chip, "native": native}, setup, reading, clock)
    policy = _adopt(policy, reading, codec, env, chip, setup, force)
    file, loop, drove = runnable(policy), None, None
    if file != policy:  # a run folder, whose environment is the user's own
        env = env or trained_in(policy)
    play = partial(run_policy, file, env, seeds=range(seed, seed + episodes))
    with _hardware(via, file) as core:
        if core is None:
            with clock.loop(setup.energy) as loop:
                comparison = play(chip=chip, setup=setup, video=video, loop=loop)
        else:
            comparison = play(chip=core.chip, setup=setup, video=video, hardware=core)
            drove = core.compare(comparison, partial(play, chip=core.chip, setup=setup))
        document = _report(comparison, setup, output, loop, drove)
    from spikedeploy.reports.terminal import print_run  # after the first action, which is sooner

    _print(document, json, print_run, tables, output, video)
    if drove:
        from spikedeploy.shipping.verilog import driven_lines

        if not json:
            typer.echo("\n".join(driven_lines(drove)))
        raise typer.Exit(0 if drove["equal"] else 1)


def _check_via(via: Path, one: Mapping[str, object], setup: Setup, *groups: object) -> None:
    """Refuse options that an export has decided, or that mean nothing in a simulation."""
    of_chips = (*vars(OnChip()), "fault", "specimen", "backend")
    found = [name for name, value in one.items() if value]
    found += [name for group in groups for name in changed(group)]
    found += [name for name in changed(setup) if name in of_chips]
    if found:
        options = ", ".join(f"--{name.strip('_').replace('_', '-')}" for name in found)
        raise ConfigError(
            f"--via {via}: the folder says what it was exported for, and a simulation is not by "
            f"the clock: leave {options} out"
        )


def _hardware(via: Path | None, policy: str) -> "AbstractContextManager[CoreDriver | None]":
    """Return the hardware of --via; None where there is none."""
    if via is None:
        return nullcontext()
    from spikedeploy.shipping.verilog import driver

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
    """Return the policy, or the one that is written from a file of another tool."""
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
    check = partial(check_fits, chip, **on_chip.arguments())
    return str(adopt(policy, codec, force, check, **convention))


def _check_output_folder(output: Path, inputs: Sequence[str], force: bool, setup: Setup) -> None:
    from spikedeploy.outputs import check_output_folder
    from spikedeploy.reports import comparison_page as report

    if setup.sampled:
        raise typer.BadParameter("-o replays greedy episodes: leave --sampled out")
    check_output_folder("-o", output, report.FILES, inputs, force, report.is_report)


def _report(
    comparison: "Comparison",
    setup: Setup,
    output: Path | None,
    loop: "PacedLoop | None" = None,
    drove: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """Return the comparison as a document, which is written where there is a folder for it."""
    from spikedeploy.reports import comparison_page as report

    document = report.document(comparison)
    if loop:
        document["real_time"] = loop.measured().as_json()
    if drove:
        document["hardware"] = drove
    if output:
        recorded = report.recordings(comparison, document["rows"], setup.options())
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
    env: EnvArgument,
    setup: Setup,
    files: PolicyNames | None = None,
    chip: Annotated[list[str], typer.Option()] | None = None,
    episodes: Count = 20,
    seed: Seed = EVALUATION,
    teacher: Annotated[str, typer.Option(metavar="TEACHER")] | None = None,
    teacher_units: Units | None = None,
    workers: Workers | None = None,
    output: OutputPath | None = None,
    tables: Tables = "one",
    force: Force = False,
    json: Json = False,
) -> None:
    """Compare policies on the same seeds: returns, agreement, spikes, operations, energy.

    files: policies: .onnx, .nir, run folders, shipped names. The float ANN, the built-in players
        and the controls are added (default: all that are shipped)
    chip: chip of the spiking policies; several with commas between them, or the option again
        (default: what each was trained for, else loihi1)
    episodes: episodes of each row
    teacher: a row for a teacher, as `distill` takes it; a function of yours runs as your code
    teacher_units: units of its actions (default: those of its kind)

    Output:
        output: folder for report.json, report.html and plots
    """
    from spikedeploy.comparison.evaluation import compare_policies, line_up
    from spikedeploy.policies.scripts import teacher_candidate
    from spikedeploy.reports.terminal import print_comparison
    from spikedeploy.runtime.chips.chip import split_names
    from spikedeploy.shipping.exported_run import runnable

    if teacher_units and teacher is None:
        raise typer.BadParameter("--teacher-units goes with --teacher")
    if output:
        inputs = [*(files or ()), *([teacher] if teacher else ())]
        _check_output_folder(output, inputs, force, setup)
    setup.check()
    taught = teacher_candidate(runnable(teacher), teacher_units) if teacher else None
    chips = split_names(",".join(chip)) if chip else None
    entries = line_up(env, [runnable(file) for file in files or ()], chips, taught, setup)
    comparison = compare_policies(env, entries, range(seed, seed + episodes), workers)
    _print(_report(comparison, setup, output), json, print_comparison, tables, output)


def play(
    *,
    env: EnvArgument,
    track: str | None = None,
    policy: Annotated[str, typer.Option(metavar="FILE")] | None = None,
    chip: ChipName | None = None,
    record: Path | None = None,
    set_: EnvOptions | None = None,
    seed: Seed = EVALUATION,
    force: Force = False,
    json: Json = False,
) -> None:
    """Drive a kart with WASD or the arrows, command a hexapod, or watch a policy.

    track: track of a kart: a name, or a .json file (default: big_S)
    policy: policy to watch (default: you drive a kart)
    record: .npz file, one for each drive
    """
    from spikedeploy.outputs import check_output
    from spikedeploy.play.display import check_display

    if record is not None:
        check_output("--record", record, (policy, track), force)
    check_display()
    from spikedeploy.evaluation_setup import parse_options
    from spikedeploy.play.drive_app import DriveApp, show
    from spikedeploy.play.session import open_session
    from spikedeploy.shipping.exported_run import runnable

    policy = policy and runnable(policy)
    options = parse_options(set_ or ()) | ({} if track is None else {"track": track})
    drive = open_session(env, options, policy, chip, seed, record)
    show(DriveApp(drive, env))
    drive.close()
    files = [str(path) for path in drive.files]
    lines = [f"{number}: {outcome.line}" for number, outcome in enumerate(drive.outcomes, 1)]
    lines += [f"wrote {path}" for path in files]
    outcomes = [vars(outcome) for outcome in drive.outcomes]
    print_result(json, {"episodes": outcomes, "files": files}, *lines)


def demo(
    *,
    tables: Tables = "one",
    show: Annotated[bool, typer.Option("--open/--no-open")] = True,
    force: Force = False,
    json: Json = False,
) -> None:
    """Replay shipped policies on an emulated Loihi beside float ones: a page with their spikes.

    show: open the page, where there is a desktop
    """
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
    policy: PolicyName,
    chip: ChipName | None = None,
    port: Annotated[int, typer.Option(min=0, max=65535)] = 5555,
    address: str = "127.0.0.1",
    clients: Annotated[int, typer.Option(min=1, max=1024)] = 32,
    idle: Annotated[str, typer.Option(metavar="TIME")] = "60s",
    limits: Limits = "on",
    backend: BackendName = "numpy",
    json: Json = False,
) -> None:
    """Answer observations with actions over ZeroMQ, on this machine.

    policy: a .nir file, run folder, shipped name
    port: TCP port; 0 for one that is free
    address: IPv4 address to listen on. Nothing is authenticated: any other than 127.0.0.1 lets
        whoever reaches it drive the policy
    clients: most clients at a time
    idle: a client that is silent so long is forgotten
    backend: what computes a chip; numba needs the extra fast
    """
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
    names: Annotated[list[str], typer.Argument(metavar="[NAME]…")] | None = None,
    episodes: Count | None = None,
    env: Annotated[str, typer.Option(metavar="module:Class")] | None = None,
    workers: Workers | None = None,
    json: Json = False,
) -> None:
    """Evaluate policies again as recorded; say equal or the first difference, and exit 1 then.

    names: shipped policies, paths of cards, folders with a report.json of `compare` (default: all
        shipped policies)
    episodes: only the first seeds (default: all recorded)
    env: environment of your own that a record names, whose code may be run
    """
    from spikedeploy import zoo
    from spikedeploy.policies.registry import confirm
    from spikedeploy.shipping import reproduce as shipping

    evaluations = [shipping.read_evaluation(name) for name in names or zoo.names()]
    for evaluation in evaluations:  # before hours of others
        confirm(evaluation.env, env, evaluation.name)
        shipping.check_episodes(evaluation, episodes or 1)
    found = []
    for evaluation in evaluations:
        found.append(shipping.reproduce(evaluation, episodes, workers))
        if not json:
            typer.echo("\n".join(_lines(found[-1])))
    if json:
        print_json([each.as_json() for each in found])
    raise typer.Exit(0 if all(each.equal for each in found) else 1)


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
    return lines
