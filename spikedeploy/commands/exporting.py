"""`export`: from a run folder or a policy to a file or folder."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import typer

from spikedeploy.commands.options import Checkpoint, ChipName, EnvName, Force, Json, OutputPath
from spikedeploy.console import print_json, say
from spikedeploy.evaluation_setup import Count, changed
from spikedeploy.runtime.choices import Clock, Granularity, Reset, State
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.files import suffix


@dataclass(frozen=True)
class FormatOptions:
    """Options that some formats have, with the defaults of the format where none is given.

    observations: recorded observations on which file and policy must agree (default: 1000)
    chip: chip whose integers are written; c, verilog and program (default: what it was trained for,
        else loihi1)

    C, Verilog, programs:
        env: environment of the recorded episode, as of one of your own that FILE.nir names as
            module:Class and whose code is not run otherwise; c, verilog, program, and onnx of a
            .nir (default: as the policy says)
        clock: how the chip's layers advance; program only (default: the network's own, else free)
        quantise: one scale for a layer, or for each neuron; c, verilog and program
        prefix: what names begin with, which is no word, function or header of C; c only
        board: board of an FPGA: icebreaker, upduino, icestick, ice40-hx8k, ulx3s; verilog only
            (default: icebreaker)
        raster: input spikes (T, M), .npy, in chip timesteps; program only (default: of an episode)

    How FILE is read:
        from_: as its author meant it, who exported it with this tool
        dt: timestep [s] (default: from the file)
        reset: membrane after a spike (default: from the file)

    NIR:
        state: membranes at an inference: reset, or kept; nir only (default: as trained)
        for_: in the scaling that the import of norse, rockpool, snntorch or spikingjelly accepts;
            nir only
        nir_compat: release of nir that opens the file
    """

    observations: Count | None = None
    chip: ChipName | None = None
    env: EnvName | None = None
    clock: Clock | None = None
    quantise: Granularity | None = None
    prefix: str | None = None
    board: str | None = None
    raster: Annotated[Path, typer.Option("--input", metavar="RASTER")] | None = None
    state: State | None = None
    checkpoint: Checkpoint | None = None
    for_: Annotated[str, typer.Option(metavar="TOOL")] | None = None
    nir_compat: Annotated[str, typer.Option(metavar="RELEASE")] | None = None
    from_: Annotated[str, typer.Option(metavar="TOOL")] | None = None
    dt: float | None = None
    reset: Reset | None = None

    def arguments(self) -> dict[str, Any]:
        """The options that were given, as `shipping.export` takes them."""
        names = {"for_": "tool", "from_": "written_by"}
        return {names.get(name, name): value for name, value in changed(self).items()}


def export(
    *,
    run: Annotated[str, typer.Argument(metavar="RUN")],
    to: str | None = None,
    output: OutputPath | None = None,
    options: FormatOptions,
    force: Force = False,
    json: Json = False,
) -> None:
    """Write a trained policy as .nir or .onnx, and check the file against it; or as C99 or Verilog.

    run: run folder, its name under runs/, or 'last'; FILE.nir
    to: format: nir, c, verilog or program for spiking policies, onnx for float ones, or for
        one step of a spiking one; c of small float ones, in 8-bit weights (default: as -o ends,
        else as the policy is)

    Output:
        output: file to write; for c, verilog and program the folder (default: in the run folder)
    """
    from spikedeploy import zoo
    from spikedeploy.reports.terminal import print_checks
    from spikedeploy.shipping.export import export as export_policy

    if suffix(run) in zoo.SUFFIXES and zoo.resolve(run) is None:
        raise ConfigError(f"{run}: no such file")  # as a run folder it would be missed elsewhere
    written = export_policy(run, to, output, force=force, **options.arguments())
    if json:
        print_json(written.record())
    else:
        print_checks(written.checks)
        for line in written.lines:
            typer.echo(line)
        for line in written.remarks:
            say(line)
    raise typer.Exit(0 if written.passed else 1)
