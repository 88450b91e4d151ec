"""`emulate`, `drift`, `check` and `verify`: networks without an environment."""

from pathlib import Path
from typing import Annotated, Any, NoReturn

import typer

from spikedeploy import seeds
from spikedeploy.commands.options import (
    Energy,
    EnvOptions,
    Force,
    Json,
    Markdown,
    OnChip,
    PageFolder,
    Reading,
    Seed,
)


def emulate(
    file: Annotated[Path, typer.Argument(exists=True, dir_okay=False, metavar="FILE.nir")],
    chip: Annotated[str, typer.Option(help="Chip, or 'float'.")],
    input_: Annotated[
        Path,
        typer.Option(
            "--input",
            exists=True,
            dir_okay=False,
            help="Spikes (T, *shape), 0 or 1, .npy; several inputs by name, .npz; or NIRData, .h5. "
            "In float any numbers.",
        ),
    ],
    output: Annotated[
        Path,
        typer.Option(
            "-o",
            "--output",
            help="Spikes of each node and `output`, or each Output, .npz, or NIRData, .h5.",
        ),
    ],
    reading: Reading,
    on_chip: OnChip,
    backend: Annotated[
        str | None,
        typer.Option(
            help="What computes a chip: auto, numpy, numba or interpreter.", show_default="numpy"
        ),
    ] = None,
    energy: Energy = None,
    force: Force = False,
    json: Json = False,
) -> None:
    """Run any NIR network on recorded spikes, and count what the chip does."""
    from dataclasses import replace

    from spikedeploy.console import print_json
    from spikedeploy.emulation.open_loop import emulate_artifact
    from spikedeploy.emulation.rasters import read_inputs
    from spikedeploy.outputs import check_output, mark, marked
    from spikedeploy.reports.terminal import print_emulation
    from spikedeploy.runtime.artifact.artifact import load
    from spikedeploy.runtime.metrics.energy import checked_table_names

    own = mark("emulate")
    check_output("-o", output, (file, input_), force, lambda path: marked(path, own))
    tables = checked_table_names(energy or ())
    artifact = load(file, **reading.arguments())
    rasters = read_inputs(input_, artifact)
    result = emulate_artifact(artifact, chip, rasters, backend, **on_chip.arguments())
    result = replace(result, tables=tables)
    result.save(output)
    if json:
        print_json(result.as_json())
    else:
        print_emulation(result)
        typer.echo(f"wrote {output}")


def drift(
    file: Annotated[str, typer.Argument(metavar="FILE", help="A .nir file, run, or shipped name.")],
    reading: Reading,
    on_chip: OnChip,
    chip: Annotated[
        str | None,
        typer.Option(help="Chip.", show_default="what it was trained for, else loihi1"),
    ] = None,
    input_: Annotated[
        Path | None,
        typer.Option("--input", exists=True, dir_okay=False, help="Spikes (T, *shape), .npy."),
    ] = None,
    random: Annotated[
        float | None,
        typer.Option(min=0, max=1, help="Draw spikes at this rate, --steps timesteps of them."),
    ] = None,
    env: Annotated[
        str | None,
        typer.Option(help="Environment to observe.", show_default="the one it was made for"),
    ] = None,
    episodes: Annotated[int, typer.Option(min=1, help="Episodes to observe.")] = 1,
    steps: Annotated[int, typer.Option(min=1, help="Control steps used of them.")] = 200,
    seed: Seed = seeds.EVALUATION,
    set_: EnvOptions = None,
    calibrate: Annotated[
        bool, typer.Option("--calibrate", help="Leave headroom for half of the inputs.")
    ] = False,
    tune: Annotated[
        bool, typer.Option("--tune", help="Search clipping and thresholds on half of the inputs.")
    ] = False,
    tau: Annotated[
        float, typer.Option(min=0.01, help="Time constant of the spike distance, in timesteps.")
    ] = 5.0,
    markdown: Markdown = False,
    output: PageFolder = None,
    force: Force = False,
    json: Json = False,
) -> None:
    """Compare a chip with the float twin spike by spike, and attribute differences to roundings."""
    from spikedeploy.console import print_json
    from spikedeploy.emulation.design_report import network_path
    from spikedeploy.emulation.drift import choose_inputs, drift_report
    from spikedeploy.make_env import parse_options
    from spikedeploy.outputs import check_output_folder
    from spikedeploy.reports.drift import drift_markdown, drift_page, print_drift
    from spikedeploy.reports.page import FILES, is_page_of, write_page
    from spikedeploy.runtime.artifact.artifact import load
    from spikedeploy.runtime.chips.chip import chip as datasheet
    from spikedeploy.shipping.export_c import chip_of
    from spikedeploy.shipping.exported_run import runnable, trained_in

    env = env or trained_in(file)
    path = network_path(runnable(file))
    if output:
        check_output_folder("-o", output, FILES, (path, input_), force, is_page_of("drift"))
    artifact = load(path, **reading.arguments())
    options = parse_options(set_ or ())
    numbers = range(seed, seed + episodes)
    inputs = choose_inputs(artifact, path, input_, random, env, numbers, steps, options)
    on = datasheet(chip or chip_of(artifact))
    report = drift_report(file, artifact, on, inputs, calibrate, tune, tau, **on_chip.arguments())
    if output:
        write_page("drift", drift_page(report), report.as_json(), output)
    if json:
        print_json(report.as_json())
    elif markdown:
        typer.echo(drift_markdown(report))
    else:
        print_drift(report)
        if output:
            typer.echo(f"wrote {output / 'report.html'}")


def check(
    file: Annotated[
        str,
        typer.Argument(metavar="FILE", help="A .nir file, a run, or the name of a shipped policy."),
    ],
    reading: Reading,
    chip: Annotated[
        list[str] | None,
        typer.Option(
            help="Chip, or 'all'; several with commas between them, or the option again.",
            show_default="all",
        ),
    ] = None,
    rules: Annotated[
        bool, typer.Option("--rules", help="Print every rule, kept or broken, and the layers.")
    ] = False,
    against: Annotated[
        Path | None,
        typer.Option(
            exists=True,
            dir_okay=False,
            metavar="RECORDED.npz",
            help="Compare the float twin with `input` and `output` spikes that your framework "
            "recorded, instead of checking chips.",
        ),
    ] = None,
    output: PageFolder = None,
    force: Force = False,
    json: Json = False,
) -> None:
    """Check whether a network fits on chips, rule by rule and node by node.

    Exit code 0: every chip that was named passes; of 'all', at least one that has limits. With
    --against: the float twin equals the recording.
    """
    from spikedeploy.console import print_json
    from spikedeploy.emulation.design_report import ALL, design_report, network_path
    from spikedeploy.outputs import check_output_folder
    from spikedeploy.reports.design import design_page, print_report
    from spikedeploy.reports.page import FILES, is_page_of, write_page
    from spikedeploy.shipping.exported_run import runnable

    file = runnable(file)
    if against is not None:
        if output:
            raise typer.BadParameter("-o writes the rules of chips: leave --against out")
        _check_against(file, against, chip, reading, json)
    if output:
        check_output_folder("-o", output, FILES, (network_path(file),), force, is_page_of("check"))
    report = design_report(file, chip or [ALL], **reading.arguments())
    if output:
        write_page("check", design_page(report), report.as_json(), output)
    if json:
        print_json(report.as_json())
    else:
        print_report(report, rules)
        if output:
            typer.echo(f"wrote {output / 'report.html'}")
    raise typer.Exit(0 if report.passed else 1)


def _check_against(
    file: str, recorded: Path, chips: list[str] | None, reading: Reading, json: bool
) -> NoReturn:
    """Print the comparison with a recording, and exit."""
    from spikedeploy.console import print_json
    from spikedeploy.emulation.design_report import network_path
    from spikedeploy.emulation.verification import against_recorded
    from spikedeploy.runtime.errors import ConfigError

    if chips:
        raise ConfigError(
            f"--against compares the float twin with a recording, and --chip {chips[0]} checks a "
            "chip. Give one of them; `drift` compares a chip with the float twin."
        )
    found = against_recorded(network_path(file), recorded, **reading.arguments())
    if json:
        print_json(found.record)
    else:
        typer.echo("\n".join(found.lines))
    raise typer.Exit(0 if found.equal else 1)


def verify(
    traces: Annotated[
        list[Path],
        typer.Argument(
            metavar="TRACE.json…",
            help="Trace files; with --network, spikes of a layer that a chip was seen to send, "
            ".npy, or of several by name, .npz.",
        ),
    ],
    reading: Reading,
    on_chip: OnChip,
    network: Annotated[
        Path | None,
        typer.Option(
            exists=True, dir_okay=False, metavar="FILE.nir", help="What the chip ran, of a .npy."
        ),
    ] = None,
    chip: Annotated[str | None, typer.Option(help="Chip that --network ran on.")] = None,
    input_: Annotated[
        Path | None,
        typer.Option(
            "--input",
            exists=True,
            dir_okay=False,
            help="Its input spikes, (T, *shape), or (B, T, *shape) of B samples, .npy.",
        ),
    ] = None,
    layer: Annotated[
        str | None,
        typer.Option(help="Node that was recorded.", show_default="the one of that shape"),
    ] = None,
    json: Json = False,
) -> None:
    """Replay traces; say equal or the first difference, and exit 1 if any differs.

    With --network, --chip and --input: recorded spikes beside those of the emulated chip.

    Exit code 2: none differs, and a file cannot be replayed.
    """
    from spikedeploy.console import print_json
    from spikedeploy.emulation.verification import replay_trace
    from spikedeploy.reports.terminal import print_verifications

    played = {"--network": network, "--chip": chip, "--input": input_}
    if any(played.values()) or traces[0].suffix in (".npy", ".npz"):
        options = {"layer": layer, **reading.arguments(), **on_chip.arguments()}
        _verify_activity(traces, played, options, json)
    if (layer, reading, on_chip) != (None, Reading(), OnChip()):
        raise typer.BadParameter(
            "options that say how a network is read or compiled, such as --layer, --dt and "
            "--limits, go with --network; a trace file says it itself"
        )
    replays = []
    for path in traces:
        replays.append(replay_trace(path))
        if not json:
            print_verifications(replays[-1:])
    if json:
        print_json([each.record for each in replays])
    if any(not each.equal and not each.failed for each in replays):
        raise typer.Exit(1)
    raise typer.Exit(0 if all(each.equal for each in replays) else 2)


def _verify_activity(
    recordings: list[Path], played: dict[str, Any], options: dict[str, Any], json: bool
) -> NoReturn:
    """Print recorded layers beside emulated ones, and exit."""
    from spikedeploy.console import print_json
    from spikedeploy.emulation.verification import against_activity
    from spikedeploy.reports.terminal import print_verifications
    from spikedeploy.runtime.errors import ConfigError

    if missing := [name for name, value in played.items() if not value]:
        given = [name for name in played if name not in missing]
        if recordings[0].suffix == ".json" and "--network" in missing:
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
