"""`export` and `publish`: from a run folder to a file, a card, or a shipped policy."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NoReturn

import typer

from spikedeploy.commands.options import AfterSpike, Granularity, States
from spikedeploy.console import print_json, print_result, say
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.files import suffix

if TYPE_CHECKING:
    from spikedeploy.exporters.check import CheckedFile

ChipClock = Literal["gated", "pipelined", "free"]


def export(
    *,
    run: str,
    to: str | None = None,
    output: Path | None = None,
    observations: int = 1000,
    chip: str | None = None,
    env: str | None = None,
    clock: ChipClock | None = None,
    quantise: Granularity = "layer",
    prefix: str = "policy",
    board: str | None = None,
    raster: Path | None = None,
    state: States | None = None,
    checkpoint: str | None = None,
    film: bool = False,
    for_: str | None = None,
    nir_compat: str | None = None,
    from_: str | None = None,
    dt: float | None = None,
    reset: AfterSpike | None = None,
    force: bool = False,
    json: bool = False,
) -> None:
    """Write a trained policy as .nir or .onnx, and check the file against it; or as C99 or Verilog.

    --to card makes the run folder ready for upload: the policy, card.md, curve.svg, report.html.
    """
    from spikedeploy import zoo
    from spikedeploy.runtime.chips.quantisation import Quantisation

    quantisation = Quantisation(quantise)
    if quantise != "layer" and to not in ("c", "verilog", "program"):
        raise typer.BadParameter("--quantise goes with --to c, verilog and program")
    if board is not None and to != "verilog":
        raise typer.BadParameter("--board goes with --to verilog")
    if film and to != "card":
        raise typer.BadParameter("--film goes with --to card")
    if suffix(run) in zoo.SUFFIXES and zoo.resolve(run) is None:
        raise ConfigError(f"{run}: no such file")  # as a run folder it would be missed elsewhere
    reading = {"written_by": from_, "dt": dt, "reset": reset}
    played: dict[str, Any] = {"raster": raster, "clock": clock}
    written_as: dict[str, Any] = {"env": env, "force": force, "quantisation": quantisation}
    if for_ or nir_compat:
        from spikedeploy.shipping.export_file import export_nir

        if to not in (None, "nir"):
            raise typer.BadParameter(f"--for and --nir-compat write nir, not {to}")
        options = {**reading, "state": state}
        checked = export_nir(run, output, for_, nir_compat, observations, options, force)
        _end_with(checked, json, list(checked.remarks), remarks=list(checked.remarks))
    if to == "program":
        from spikedeploy.shipping.export_program import export_program

        program = export_program(
            run, chip, output, observations, options=reading, **written_as, **played
        )
        print_result(json, program.record(), *program.lines)
        return
    if any(value is not None for value in played.values()):
        raise typer.BadParameter("--input and --clock go with --to program")
    if env is not None and to not in ("c", "verilog", "onnx"):
        raise typer.BadParameter("--env goes with --to c, verilog, program and onnx")
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

        code = export_c(run, chip, output, observations, prefix, **written_as)
        print_result(json, code.record(), *code.lines)
        return
    if to == "verilog":
        from spikedeploy.shipping.export_verilog import export_verilog

        core = export_verilog(run, chip, board, output, observations, **written_as)
        print_result(json, core.record(), *core.lines)
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
        written = export_onnx(run, output, observations, force, env)
    else:
        if env is not None:
            raise typer.BadParameter("a run is played in the environment of its training: no --env")
        written = export_run(
            run, to, output, observations, state=state, checkpoint=checkpoint, force=force
        )
    late = written.unfinished
    _end_with(written, json, [f"its training is unfinished: stopped at {late}"] if late else [])


def _end_with(written: "CheckedFile", json: bool, lines: Sequence[str], **more: object) -> NoReturn:
    """Print the file and its checks, `more` in JSON; exit 1 where one failed."""
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


def publish(
    *,
    run: str,
    name: str,
    episodes: int = 100,
    note: str = "",
    control: bool = False,
    checkpoint: str | None = None,
    workers: int | None = None,
    output: Path | None = None,
    force: bool = False,
    json: bool = False,
) -> None:
    """Export a run into the zoo: the file, its card, its learning curve and its evaluation."""
    from spikedeploy import zoo
    from spikedeploy.shipping.publish_run import publish_run

    folder = output or zoo.FOLDER
    files = publish_run(run, name, episodes, folder, workers, note, control, checkpoint, force)
    _name_files(files, json)


def _name_files(files: Sequence[Path], json: bool) -> None:
    names = [str(file) for file in files]
    print_result(json, {"files": names}, f"wrote {', '.join(names)}")
