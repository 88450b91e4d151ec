"""`verify`: what chips and their emulators were recorded to do, once more."""

from pathlib import Path
from typing import Annotated, Any, NoReturn

import typer

from spikedeploy.commands.options import (
    Delay,
    Dt,
    From,
    Integrator,
    Json,
    Like,
    LimitsOption,
    Quantise,
    Reset,
    quantisation,
)


def verify(
    traces: Annotated[
        list[Path],
        typer.Argument(
            metavar="TRACE.json…",
            help="Trace files; with --network, spikes of a layer that a chip was seen to send, "
            ".npy, or of several by name, .npz.",
        ),
    ],
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
    dt: Dt = None,
    reset: Reset = None,
    integrator: Integrator = None,
    delay: Delay = None,
    like: Like = None,
    from_: From = None,
    quantise: Quantise = "layer",
    limits: LimitsOption = "on",
    json: Json = False,
) -> None:
    """Replay traces; say equal or the first difference, and exit 1 if any differs.

    With --network, --chip and --input: recorded spikes beside those of the emulated chip.

    Exit code 2: none differs, and a file cannot be replayed.
    """
    from spikedeploy.console import print_json
    from spikedeploy.emulation.trace_replay import replay_trace
    from spikedeploy.reports.terminal import print_replays

    played = {"--network": network, "--chip": chip, "--input": input_}
    convention = {"dt": dt, "reset": reset, "integrator": integrator, "delay": delay}
    given: dict[str, Any] = {**convention, "like": like, "written_by": from_, "layer": layer}
    if any(played.values()) or traces[0].suffix in (".npy", ".npz"):
        rounded = quantisation(quantise, None, "none", None, 0)
        options = {**given, "limits": limits == "on", "quantisation": rounded}
        _verify_activity(traces, played, options, json)
    if any(value is not None for value in given.values()) or (quantise, limits) != ("layer", "on"):
        raise typer.BadParameter(
            "options that say how a network is read or compiled, such as --layer, --dt and "
            "--limits, go with --network; a trace file says it itself"
        )
    replays = []
    for path in traces:
        replays.append(replay_trace(path))
        if not json:
            print_replays(replays[-1:])
    if json:
        print_json([each.as_json() for each in replays])
    if any(each.verdict is not None and not each.equal for each in replays):
        raise typer.Exit(1)
    raise typer.Exit(0 if all(each.equal for each in replays) else 2)


def _verify_activity(
    recordings: list[Path], played: dict[str, Any], options: dict[str, Any], json: bool
) -> NoReturn:
    """Print recorded layers beside emulated ones, and exit."""
    from spikedeploy.console import print_json
    from spikedeploy.emulation.recordings import against_activity
    from spikedeploy.reports.terminal import print_replays
    from spikedeploy.runtime.errors import ConfigError

    if missing := [name for name, value in played.items() if not value]:
        options_given = [name for name in played if name not in missing]
        if recordings[0].suffix == ".json" and "--network" in missing:
            raise ConfigError(
                f"{recordings[0]}: a trace needs no options, as it says network, chip and input "
                f"itself: leave {' and '.join(options_given)} out"
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
        print_json([each.as_json() for each in found])
    else:
        print_replays(found)
    raise typer.Exit(0 if all(each.equal for each in found) else 1)
