"""`export` and `publish`: from a run folder to a file, a card, or a shipped policy."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from spikedeploy.commands.options import (
    Dt,
    For,
    Force,
    From,
    Json,
    NirCompat,
    Reset,
    States,
    Workers,
)

if TYPE_CHECKING:
    from spikedeploy.exporters.check import CheckedFile

ChipClock = Literal["gated", "pipelined", "free"]
Checkpoint = Annotated[
    str | None,
    typer.Option(
        metavar="NAME",
        help="Checkpoint of the run, such as last or ops-480.",
        show_default="best, else last",
    ),
]


def export(
    run: Annotated[
        str,
        typer.Argument(
            metavar="RUN", help="Run folder, its name under runs/, or 'last'; FILE.nir."
        ),
    ],
    to: Annotated[
        str | None,
        typer.Option(
            help="Format: nir, c, program or xylo for spiking policies, onnx for float ones, or "
            "for one step of a spiking one; c of small float ones, in 8-bit weights; or card.",
            show_default="as -o ends, else as the policy is",
        ),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option(
            "-o",
            "--output",
            help="File to write; for c and program the folder.",
            show_default="in the run folder",
        ),
    ] = None,
    observations: Annotated[
        int, typer.Option(min=1, help="Recorded observations on which file and policy must agree.")
    ] = 1000,
    chip: Annotated[
        str | None,
        typer.Option(
            help="Chip whose integers are written; c, program and xylo.",
            show_default="what it was trained for, else loihi1; xylo needs one",
        ),
    ] = None,
    env: Annotated[
        str | None,
        typer.Option(
            metavar="ENV",
            help="Environment of the recorded episode; program only.",
            show_default="as the policy says",
        ),
    ] = None,
    clock: Annotated[
        ChipClock | None,
        typer.Option(
            help="How the chip's layers advance; program only.",
            show_default="the network's own, else free",
        ),
    ] = None,
    prefix: Annotated[str, typer.Option(help="What names begin with; c only.")] = "policy",
    raster: Annotated[
        Path | None,
        typer.Option(
            "--input",
            metavar="RASTER",
            help="Input spikes (T, M), .npy, in chip timesteps; program only.",
            show_default="of an episode",
        ),
    ] = None,
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
    for_: For = None,
    nir_compat: NirCompat = None,
    from_: From = None,
    dt: Dt = None,
    reset: Reset = None,
    force: Force = False,
    json: Json = False,
) -> None:
    """Write a trained policy as .nir or .onnx, and check the file against it; or as C99.

    --to card makes the run folder ready for upload: the policy, card.md, curve.svg, report.html.
    """
    if film and to != "card":
        raise typer.BadParameter("--film goes with --to card")
    _check_file(run)
    given = {"written_by": from_, "dt": dt, "reset": reset}
    if for_ or nir_compat:
        options = {**given, "state": state}
        _export_for(run, to, output, for_, nir_compat, observations, options, force, json)
        return
    if to == "program":
        played = {"raster": raster, "env": env, "clock": clock, "options": given}
        _export_program(run, chip, output, observations, played, force, json)
        return
    if any(value is not None for value in (raster, env, clock)):
        raise typer.BadParameter("--input, --env and --clock go with --to program")
    if to == "xylo":
        _export_xylo(run, chip, output, observations, given, force, json)
        return
    if any(value is not None for value in given.values()):
        raise typer.BadParameter(
            "--from, --dt and --reset go with --for, --nir-compat, --to program or --to xylo"
        )
    if to == "c":
        _export_c(run, chip, output, observations, prefix, force, json)
        return
    if to == "card":
        _export_card(run, output, checkpoint, film, force, json)
        return
    from spikedeploy.shipping.export_file import export_onnx, is_nir_file
    from spikedeploy.shipping.export_run import export_run

    if to == "onnx" and is_nir_file(run):
        written = export_onnx(run, output, observations, force)
    else:
        written = export_run(
            run, to, output, observations, state=state, checkpoint=checkpoint, force=force
        )
    late = written.unfinished
    _end_with(written, json, [f"its training is unfinished: stopped at {late}"] if late else [])


def _check_file(reference: str) -> None:
    """Refuse a file that does not exist: as a run folder it would be missed in the wrong place."""
    from spikedeploy import zoo
    from spikedeploy.runtime.errors import ConfigError

    if reference.endswith(zoo.SUFFIXES) and zoo.resolve(reference) is None:
        raise ConfigError(f"{reference}: no such file")


def _export_c(
    policy: str,
    chip: str | None,
    folder: Path | None,
    observations: int,
    prefix: str,
    force: bool,
    json: bool,
) -> None:
    """Write a policy as C, of a chip if it spikes, and say what that takes."""
    from spikedeploy.console import print_json
    from spikedeploy.shipping import export_c as shipping

    written = shipping.export_c(policy, chip, folder, observations, prefix, force)
    if json:
        print_json(written.record())
        return
    for line in written.lines:
        typer.echo(line)


def _export_program(
    policy: str,
    chip: str | None,
    folder: Path | None,
    steps: int,
    played: Mapping[str, Any],
    force: bool,
    json: bool,
) -> None:
    """Write the kit of a chip, and say what to type next."""
    from spikedeploy.console import print_json
    from spikedeploy.shipping import export_program as shipping

    written = shipping.export_program(policy, chip, folder, steps, force=force, **played)
    if json:
        print_json(written.record())
        return
    for line in written.lines:
        typer.echo(line)


def _export_for(
    policy: str,
    to: str | None,
    output: Path | None,
    tool: str | None,
    older: str | None,
    timesteps: int,
    options: Mapping[str, Any],
    force: bool,
    json: bool,
) -> None:
    """Write the file, and say whether it is the same network."""
    from spikedeploy.shipping.export_file import export_nir

    if to not in (None, "nir"):
        raise typer.BadParameter(f"--for and --nir-compat write nir, not {to}")
    written = export_nir(policy, output, tool, older, timesteps, options, force)
    remarks = list(written.remarks)
    _end_with(written, json, remarks, remarks=remarks)


def _export_xylo(
    policy: str,
    chip: str | None,
    output: Path | None,
    timesteps: int,
    options: Mapping[str, Any],
    force: bool,
    json: bool,
) -> None:
    """Write the specification, and say whether it computes the same."""
    from spikedeploy.shipping.export_file import export_xylo

    written = export_xylo(policy, chip, output, timesteps, options, force)
    remarks = list(written.remarks)
    _end_with(written, json, remarks, remarks=remarks)


def _end_with(written: "CheckedFile", json: bool, said: Sequence[str], **more: object) -> None:
    """Say what was written and whether it passed; `more` is for JSON. Exit 1 where it did not."""
    from spikedeploy.console import print_json, say
    from spikedeploy.reports.terminal import print_checks

    if json:
        checks = [vars(check) for check in written.checks]
        record = {"path": str(written.path), "passed": written.passed, "checks": checks}
        print_json({**record, **more})
    else:
        print_checks(written.checks)
        typer.echo(f"wrote {written.path}")
        for line in said:
            say(line)
    raise typer.Exit(0 if written.passed else 1)


def _export_card(
    run: str, output: Path | None, checkpoint: str | None, film: bool, force: bool, json: bool
) -> None:
    """Write what shows a run beside its policy into its folder, and say what."""
    from spikedeploy.shipping import run_card

    if output is not None or checkpoint is not None:
        raise typer.BadParameter("--to card is of the run folder: leave -o and --checkpoint out")
    files = run_card.export_card(run, film, force)
    _name_files(files, json)


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
    from spikedeploy.shipping.publish_run import publish_run

    folder = output or zoo.FOLDER
    files = publish_run(run, name, episodes, folder, workers, note, control, checkpoint, force)
    _name_files(files, json)


def _name_files(files: Sequence[Path], json: bool) -> None:
    from spikedeploy.console import print_json

    if json:
        print_json({"files": [str(file) for file in files]})
    else:
        typer.echo("wrote " + ", ".join(str(file) for file in files))
