"""`emulate`, `drift`, `check` and `verify`: networks without an environment."""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, NoReturn

import typer

from spikedeploy.commands.options import (
    ChipName,
    EnergyTables,
    EnvName,
    EnvOptions,
    File,
    Force,
    Json,
    NetworkFile,
    OutputPath,
    PolicyName,
    ReportFolder,
    Seed,
    Tables,
)
from spikedeploy.console import print_json, print_result
from spikedeploy.evaluation_setup import Count, OnChip, Reading
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.files import suffix
from spikedeploy.seeds import EVALUATION

if TYPE_CHECKING:
    from collections.abc import Sequence

    from spikedeploy.runtime.artifact.artifact import Artifact


Channels = Literal["off-on", "on-off"]


@dataclass(frozen=True)
class FromCamera:
    """A recording of an event camera as input.

    Events of a camera:
        events: recording instead of --input: HDF5, AEDAT 4, Prophesee .raw and .dat, NumPy .npy
        camera: height and width of the camera in pixels (default: from the recording, else what the
            network takes)
        region: part of the camera that the network sees (default: all)
        downsample: pixels along each axis that become one
        channels: polarities of an input of two channels: light falls, then rises, as in Tonic; or
            the other way round, as the event camera observes
        time_step: time of a timestep, in which events are counted: 1ms (default: dt of the network)
        step: count events in timesteps, or give the chip one after another, as --chip
            speck2f:queue=on takes them
        page: folder for report.html, which replays events, spikes and output
    """

    events: Annotated[Path, typer.Option(metavar="FILE", exists=True, dir_okay=False)] | None = None
    camera: Annotated[str, typer.Option(metavar="HxW")] | None = None
    region: Annotated[str, typer.Option(metavar="x,y,w,h")] | None = None
    downsample: Count = 1
    channels: Channels = "off-on"
    time_step: Annotated[str, typer.Option(metavar="TIME")] | None = None
    step: Literal["time", "event"] = "time"
    page: Annotated[Path, typer.Option(metavar="FOLDER")] | None = None

    def size(self) -> tuple[int, int] | None:
        """Return (height, width) of the camera [pixels], where it was given."""
        if self.camera is None:
            return None
        height, width = _whole_numbers("--camera", self.camera, "x", "height x width, as in 48x64")
        if min(height, width) < 1:
            raise ConfigError(f"--camera {self.camera}: the least is 1x1 pixel.")
        return height, width

    def part(self) -> tuple[int, int, int, int] | None:
        """Return x, y, width and height of the region [pixels], where it was given."""
        if self.region is None:
            return None
        form = "x,y,width,height in pixels, as in 0,0,64,48"
        x, y, width, height = _whole_numbers("--region", self.region, ",", form)
        return x, y, width, height

    def seconds(self) -> float | None:
        """Return the duration of a timestep [s], where it was given."""
        from spikedeploy.realtime.paced_loop import duration

        return None if self.time_step is None else duration("--time-step", self.time_step)


def _whole_numbers(option: str, text: str, between: str, form: str) -> list[int]:
    """Return the numbers of a text, as many as its form shows."""
    parts = text.split(between)
    as_form = len(parts) == form.partition(" as in ")[2].count(between) + 1
    if not as_form or not all(re.fullmatch(r"\s*-?[0-9]{1,9}\s*", part) for part in parts):
        raise ConfigError(f"{option} {text[:40]!r} is no {form}.")
    return [int(part) for part in parts]


def emulate(
    *,
    file: NetworkFile,
    chip: ChipName,
    reading: Reading,
    on_chip: OnChip,
    camera: FromCamera,
    input_: File | None = None,
    output: OutputPath | None = None,
    backend: str | None = None,
    energy: EnergyTables | None = None,
    tables: Tables = "one",
    force: Force = False,
    json: Json = False,
) -> None:
    """Run any NIR network on recorded spikes or events, and count what the chip does.

    file: the network
    chip: chip, or 'float'
    input_: spikes (T, *shape), 0 or 1, .npy; several inputs by name, .npz; or NIRData, .h5. In
        float any numbers

    Output:
        output: spikes of each node and `output`, or each Output, .npz, or NIRData, .h5; with
            --events only .h5 (default: they are counted alone)
        tables: print outputs, counts and energies, or all: NeuroBench's measures too

    The emulated chip:
        backend: what computes a chip: auto, numpy, numba or interpreter (default: numpy)
    """
    from dataclasses import replace

    from spikedeploy.emulation.raster_emulation import emulate_artifact
    from spikedeploy.emulation.rasters import read_inputs
    from spikedeploy.outputs import check_output, has_text, mark
    from spikedeploy.reports.network_runs import print_emulation
    from spikedeploy.runtime.artifact.artifact import load
    from spikedeploy.runtime.metrics.energy import checked_table_names

    own = mark("emulate")
    if output:
        inputs = (file, input_, camera.events)
        check_output("-o", output, inputs, force, lambda path: has_text(path, own))
    priced = checked_table_names(energy or ())
    if camera.events is not None:
        if tables == "all":
            raise typer.BadParameter("--tables all goes with --input")
        if input_ is not None:
            raise typer.BadParameter("--input and --events are two inputs: give one of them")
        artifact = load(file, **reading.arguments())
        options = {"backend": backend, **on_chip.arguments()}
        paths = (file, camera.events, output)
        _emulate_events(artifact, chip, camera, options, priced, paths, force, json)
        return
    if camera != FromCamera():
        raise typer.BadParameter("--camera, --region, --time-step and --page go with --events")
    if input_ is None:
        raise typer.BadParameter("give spikes with --input FILE, or a recording with --events FILE")
    artifact = load(file, **reading.arguments())
    rasters = read_inputs(input_, artifact)
    result = emulate_artifact(artifact, chip, rasters, backend, **on_chip.arguments())
    result = replace(result, tables=priced)
    if output:
        result.save(output)
    if json:
        print_json(result.as_json())
        return
    print_emulation(result, tables == "all")
    if output:
        typer.echo(f"wrote {output}")


def _emulate_events(
    artifact: "Artifact",
    chip: str,
    camera: FromCamera,
    options: dict[str, Any],
    tables: "Sequence[str]",
    paths: tuple[Path, Path, Path | None],
    force: bool,
    json: bool,
) -> None:
    """Run a network over the recording of an event camera. paths: of both, and of -o."""
    from contextlib import ExitStack
    from dataclasses import replace

    from spikedeploy.emulation.event_files import open_recording
    from spikedeploy.emulation.event_input import input_shape, read_input, view_of
    from spikedeploy.emulation.event_replay import Replay
    from spikedeploy.emulation.event_stream import emulate_events, write_spikes
    from spikedeploy.outputs import check_output_folder
    from spikedeploy.reports.network_runs import event_page, print_event_run
    from spikedeploy.reports.page import FILES, is_page_of, write_page

    file, events, output = paths
    if camera.step == "event" and camera.time_step is not None:
        raise typer.BadParameter("--step event has no timesteps: leave --time-step out")
    if camera.page:
        check_output_folder("--page", camera.page, FILES, paths, force, is_page_of("emulate"))
    _, height, width = input_shape(artifact)
    size, region = camera.size(), camera.part()
    fallback = (height * camera.downsample, width * camera.downsample) if region is None else None
    recording = open_recording(events, size, fallback)
    is_on_first = camera.channels == "on-off"
    view = view_of(artifact, recording.size, region, camera.downsample, is_on_first)
    seconds = None
    if camera.step == "time":
        seconds = camera.seconds() or artifact.convention.dt
    given = read_input(recording, view, seconds)
    listeners: list[Any] = [Replay(artifact, given)] if camera.page else []
    with ExitStack() as stack:
        if output:
            listeners.append(stack.enter_context(write_spikes(output, artifact, given)))
        run = emulate_events(artifact, chip, given, listeners, **options)
    convention = artifact.convention
    if seconds and camera.time_step is None and "snnTorch" in convention.source:
        remark = (
            f"timesteps of {convention.dt * 1e3:g} ms, as snnTorch writes whatever was meant: "
            "--time-step gives those in which the network was trained"
        )
        run = replace(run, remarks=(*run.remarks, remark))
    run = replace(run, tables=tables)
    if camera.page:
        html = event_page(file.stem, run, listeners[0])
        write_page("emulate", html, run.as_json(), camera.page)
    if json:
        print_json(run.as_json())
        return
    print_event_run(run)
    if output:
        typer.echo(f"wrote {output}")
    _name_page(camera.page)


def drift(
    *,
    file: PolicyName,
    reading: Reading,
    on_chip: OnChip,
    chip: ChipName | None = None,
    input_: File | None = None,
    random: Annotated[float, typer.Option(min=0, max=1)] | None = None,
    env: EnvName | None = None,
    episodes: Count = 1,
    steps: Count = 200,
    seed: Seed = EVALUATION,
    set_: EnvOptions | None = None,
    tau: Annotated[float, typer.Option(min=0.01)] = 5.0,
    output: ReportFolder | None = None,
    force: Force = False,
    json: Json = False,
) -> None:
    """Compare a chip with the float twin spike by spike, and attribute differences to roundings.

    file: a .nir file, run, or shipped name
    chip: chip (default: what it was trained for, else loihi1)
    input_: spikes (T, *shape), .npy
    random: draw spikes at this rate, --steps timesteps of them
    env: environment to observe (default: the one it was made for)
    episodes: episodes to observe
    steps: control steps used of them
    tau: time constant of the spike distance, in timesteps

    Output:
    """
    from spikedeploy.emulation.design_report import network_path
    from spikedeploy.emulation.drift_report import choose_inputs, drift_report
    from spikedeploy.evaluation_setup import parse_options
    from spikedeploy.outputs import check_output_folder
    from spikedeploy.reports.drift_page import drift_page, print_drift
    from spikedeploy.reports.page import FILES, is_page_of, write_page
    from spikedeploy.runtime.artifact.artifact import load
    from spikedeploy.runtime.chips.chip import chip as datasheet
    from spikedeploy.shipping.exported_run import runnable, trained_in
    from spikedeploy.shipping.sources import chip_of

    env = env or trained_in(file)
    path = network_path(runnable(file))
    if output:
        check_output_folder("-o", output, FILES, (path, input_), force, is_page_of("drift"))
    artifact = load(path, **reading.arguments())
    options = parse_options(set_ or ())
    numbers = range(seed, seed + episodes)
    inputs = choose_inputs(artifact, path, input_, random, env, numbers, steps, options)
    chip = chip or chip_of(artifact)
    report = drift_report(
        file,
        artifact,
        datasheet(chip),
        inputs,
        tau,
        **on_chip.arguments(),
    )
    if output:
        write_page("drift", drift_page(report), report.as_json(), output)
    if json:
        print_json(report.as_json())
    else:
        print_drift(report)
        _name_page(output)


def _name_page(folder: Path | None) -> None:
    if folder:
        typer.echo(f"wrote {folder / 'report.html'}")


def check(
    *,
    file: PolicyName,
    reading: Reading,
    chip: Annotated[list[str], typer.Option()] | None = None,
    rules: bool = False,
    board: str | None = None,
    against: Annotated[Path, typer.Option(metavar="RECORDED.npz", exists=True, dir_okay=False)]
    | None = None,
    output: ReportFolder | None = None,
    force: Force = False,
    json: Json = False,
) -> None:
    """Check whether a network fits on chips, rule by rule and node by node.

    Exit code 0: every chip that was named passes; of 'all', at least one that has limits. With
    --against: the float twin equals the recording. With --board: it fits on that FPGA.

    file: a .nir file, a run, or the name of a shipped policy
    chip: chip, or 'all'; several with commas between them, or the option again (default: all)
    rules: print every rule, kept or broken, and the layers
    board: check whether the core of `export --to verilog` fits on an FPGA, and no chips:
        icebreaker, upduino, icestick, ice40-hx8k, ulx3s
    against: compare the float twin with `input` and `output` spikes that your framework recorded,
        instead of checking chips
    """
    from spikedeploy.emulation.design_report import ALL, network_path, report_of
    from spikedeploy.outputs import check_output_folder
    from spikedeploy.reports.design import design_page, print_report
    from spikedeploy.reports.page import FILES, is_page_of, write_page
    from spikedeploy.runtime.artifact.artifact import load
    from spikedeploy.shipping.exported_run import runnable

    file = runnable(file)
    if board is not None:
        if output or against or rules:
            more = "--rules, --against, -o"
            raise typer.BadParameter(f"--board says what is full: leave {more} out")
        _check_board(file, board, chip, reading, json)
    if against is not None:
        if output:
            raise typer.BadParameter("-o is for rules of chips: leave --against out")
        _check_against(file, against, chip, reading, json)
    path = network_path(file)
    if output:
        check_output_folder("-o", output, FILES, (path,), force, is_page_of("check"))
    options = reading.arguments()
    report = report_of(file, load(path, **options), chip or [ALL], path, options)
    if output:
        write_page("check", design_page(report), report.as_json(), output)
    if json:
        print_json(report.as_json())
    else:
        print_report(report, rules)
        _name_page(output)
    raise typer.Exit(0 if report.passed else 1)


def _check_board(
    file: str, board: str, chips: list[str] | None, reading: Reading, json: bool
) -> NoReturn:
    """Print what of a board's FPGA a network takes, before any synthesis, and exit."""
    from spikedeploy.emulation.design_report import network_path
    from spikedeploy.shipping.verilog import design

    if len(chips or ()) > 1:
        raise ConfigError("--board: a core has the integers of one chip: name one with --chip")
    chip = chips[0] if chips else None
    made = design(str(network_path(file)), chip, board, **reading.arguments())
    print_result(json, made.record, *made.lines)
    raise typer.Exit(0 if made.use.fits else 1)


def _check_against(
    file: str, recorded: Path, chips: list[str] | None, reading: Reading, json: bool
) -> NoReturn:
    """Print the comparison with a recording, and exit."""
    from spikedeploy.emulation.design_report import network_path
    from spikedeploy.emulation.framework_recordings import compare_with_recording

    if chips:
        raise ConfigError(
            f"--against compares the float twin with a recording, and --chip {chips[0]} checks a "
            "chip. Give one of them; `drift` compares a chip with the float twin."
        )
    found = compare_with_recording(network_path(file), recorded, **reading.arguments())
    print_result(json, found.record, *found.lines)
    raise typer.Exit(0 if found.equal else 1)


def verify(
    *,
    traces: Annotated[list[Path], typer.Argument(metavar="TRACE.json…")],
    reading: Reading,
    on_chip: OnChip,
    network: File | None = None,
    chip: ChipName | None = None,
    input_: File | None = None,
    layer: str | None = None,
    json: Json = False,
) -> None:
    """Replay traces; say equal or the first difference, and exit 1 if any differs.

    With --network, --chip and --input: recorded spikes beside those of the emulated chip.

    Exit code 2: none differs, and a file cannot be replayed.

    traces: trace files, or folders of them; with --network, spikes of a layer that a chip was seen
        to send, .npy, or of several by name, .npz
    network: what the chip ran, of a .npy
    chip: chip that --network ran on
    input_: its input spikes, (T, *shape), or (B, T, *shape) of B samples, .npy
    layer: node that was recorded (default: the one of that shape)
    """
    from spikedeploy.emulation.verification import replay_trace
    from spikedeploy.reports.terminal import print_verifications

    played = {"--network": network, "--chip": chip, "--input": input_}
    if any(played.values()) or suffix(traces[0]) in (".npy", ".npz"):
        options = {"layer": layer, **reading.arguments(), **on_chip.arguments()}
        _verify_activity(traces, played, options, json)
    if (layer, reading, on_chip) != (None, Reading(), OnChip()):
        raise typer.BadParameter(
            "options that say how a network is read or compiled, such as --layer, --dt and "
            "--limits, go with --network; a trace file says it itself"
        )
    replays = []
    # of a folder its traces; an empty one is refused as a trace is
    for path in (file for each in traces for file in _traces_in(each) or [each]):
        replays.append(replay_trace(path))
        if not json:
            print_verifications(replays[-1:])
    if json:
        print_json([each.record for each in replays])
    if any(not each.equal and not each.failed for each in replays):
        raise typer.Exit(1)
    raise typer.Exit(0 if all(each.equal for each in replays) else 2)


def _traces_in(folder: Path) -> list[Path]:
    """The JSON files in a folder; none in a file."""
    return sorted(file for file in folder.glob("*") if suffix(file) == ".json")


def _verify_activity(
    recordings: list[Path], played: dict[str, Any], options: dict[str, Any], json: bool
) -> NoReturn:
    """Print recorded layers beside emulated ones, and exit."""
    from spikedeploy.emulation.verification import against_activity
    from spikedeploy.reports.terminal import print_verifications

    if missing := [name for name, value in played.items() if not value]:
        given = [name for name in played if name not in missing]
        if suffix(recordings[0]) == ".json" and "--network" in missing:
            raise ConfigError(
                f"{recordings[0]}: a trace needs no options, as it says network, chip and input "
                f"itself: leave {' and '.join(given)} out"
            )
        raise ConfigError(
            f"{recordings[0]}: recorded spikes are compared with a network on a chip, which takes "
            f"--network, --chip and --input: give {' and '.join(missing)} too"
        )
    network, chip, inputs = played.values()
    found = [
        each
        for recording in recordings
        for each in against_activity(recording, network, inputs, chip, **options)
    ]
    if json:
        print_json([each.record for each in found])
    else:
        print_verifications(found)
    raise typer.Exit(0 if all(each.equal for each in found) else 1)
