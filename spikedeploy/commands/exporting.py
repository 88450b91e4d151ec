"""`export` and `publish`: from a run folder to a file, a card, or a shipped policy."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, NoReturn

import typer

from spikedeploy.commands.options import (
    Dt,
    Force,
    From,
    Json,
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
    for_: Annotated[
        str | None,
        typer.Option(
            "--for",
            metavar="TOOL",
            help="In the scaling that the import of norse, rockpool, snntorch or spikingjelly "
            "accepts; nir only.",
        ),
    ] = None,
    nir_compat: Annotated[
        str | None,
        typer.Option("--nir-compat", metavar="RELEASE", help="Release of nir that opens the file."),
    ] = None,
    from_: From = None,
    dt: Dt = None,
    reset: Reset = None,
    force: Force = False,
    json: Json = False,
) -> None:
    """Write a trained policy as .nir or .onnx, and check the file against it; or as C99.

    --to card makes the run folder ready for upload: the policy, card.md, curve.svg, report.html.
    """
    from spikedeploy import zoo
    from spikedeploy.runtime.errors import ConfigError

    if film and to != "card":
        raise typer.BadParameter("--film goes with --to card")
    if run.endswith(zoo.SUFFIXES) and zoo.resolve(run) is None:
        raise ConfigError(f"{run}: no such file")  # as a run folder it would be missed elsewhere
    reading = {"written_by": from_, "dt": dt, "reset": reset}
    played: dict[str, Any] = {"raster": raster, "env": env, "clock": clock}
    if for_ or nir_compat:
        from spikedeploy.shipping.export_file import export_nir

        if to not in (None, "nir"):
            raise typer.BadParameter(f"--for and --nir-compat write nir, not {to}")
        options = {**reading, "state": state}
        checked = export_nir(run, output, for_, nir_compat, observations, options, force)
        _end_with(checked, json, list(checked.remarks), remarks=list(checked.remarks))
    if to == "program":
        from spikedeploy.shipping.export_program import export_program

        _print_files(
            export_program(run, chip, output, observations, options=reading, force=force, **played),
            json,
        )
        return
    if any(value is not None for value in played.values()):
        raise typer.BadParameter("--input, --env and --clock go with --to program")
    if to == "xylo":
        from spikedeploy.shipping.export_file import export_xylo

        specified = export_xylo(run, chip, output, observations, reading, force)
        _end_with(specified, json, list(specified.remarks), remarks=list(specified.remarks))
    if any(value is not None for value in reading.values()):
        raise typer.BadParameter(
            "--from, --dt and --reset go with --for, --nir-compat, --to program or --to xylo"
        )
    if to == "c":
        from spikedeploy.shipping.export_c import export_c

        _print_files(export_c(run, chip, output, observations, prefix, force), json)
        return
    if to == "card":
        from spikedeploy.shipping.run_card import export_card

        if output is not None or checkpoint is not None:
            raise typer.BadParameter(
                "--to card is of the run folder: leave -o and --checkpoint out"
            )
        _name_files(export_card(run, film, force), json)
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


def _end_with(written: "CheckedFile", json: bool, lines: Sequence[str], **more: object) -> NoReturn:
    """Print the file and its checks, `more` in JSON; exit 1 where one failed."""
    from spikedeploy.console import print_json, say
    from spikedeploy.reports.terminal import print_checks

    if json:
        checks = [vars(check) for check in written.checks]
        record = {"path": str(written.path), "passed": written.passed, "checks": checks}
        print_json({**record, **more})
    else:
        print_checks(written.checks)
        typer.echo(f"wrote {written.path}")
        for line in lines:
            say(line)
    raise typer.Exit(0 if written.passed else 1)


def _print_files(written: Any, json: bool) -> None:  # noqa: ANN401 - with record() and lines
    from spikedeploy.console import print_json

    if json:
        print_json(written.record())
    else:
        typer.echo("\n".join(written.lines))


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
