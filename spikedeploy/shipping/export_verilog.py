"""A policy as Verilog for a board: what is written, what it takes, and what is refused before."""

from dataclasses import dataclass
from pathlib import Path
from shlex import quote
from typing import Any

from spikedeploy import zoo
from spikedeploy.exporters.c.packaging import MAKEFILE
from spikedeploy.exporters.check import ExportResult
from spikedeploy.exporters.verilog.bench import clocks_of
from spikedeploy.exporters.verilog.board_files import board_files
from spikedeploy.exporters.verilog.boards import Board
from spikedeploy.exporters.verilog.boards import board as board_named
from spikedeploy.exporters.verilog.image import CoreImage, core_image
from spikedeploy.exporters.verilog.resources import Use, predict
from spikedeploy.exporters.verilog.to_verilog import core_files
from spikedeploy.outputs import check_output_folder
from spikedeploy.runtime.artifact.artifact import Artifact
from spikedeploy.runtime.chips.chip import chip as chip_named
from spikedeploy.runtime.chips.quantisation import PLAIN, Granularity, Quantisation
from spikedeploy.runtime.codec.codec import Codec
from spikedeploy.runtime.compiler.compile import compile_program, own_clock
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.shipping.sources import SpikingSource, chip_of, named_env, require_output
from spikedeploy.shipping.verilog_folder import (
    RECORD,
    VerilogFolder,
    check_unchanged,
    is_export,
    sums_of,
    write_folder,
)

DEFAULT_BOARD = "icebreaker"
# control steps of which the clocks are counted
_COUNTED = 50


@dataclass(frozen=True)
class CoreDesign:
    """A policy on a core, on a board; nothing is written yet.

    chip: chip whose integers the core computes.
    """

    codec: Codec
    chip: str
    program: Program
    image: CoreImage
    board: Board

    @property
    def use(self) -> Use:
        """Share of the board's FPGA that it takes, predicted before synthesis."""
        return predict(self.image, self.board)

    @property
    def lines(self) -> tuple[str, ...]:
        """The use for a terminal."""
        use, on = self.use, self.board
        verdict = "fits on" if use.fits else "does not fit on"
        head = f"{verdict} {on.title} ({on.device.title}), as predicted before synthesis"
        return (head, *use.lines())

    @property
    def record(self) -> dict[str, Any]:
        """The use as data."""
        return {"board": self.board.name, "chip": self.chip, **self.use.record()}


def design(
    policy: str,
    chip: str | None,
    board: str | None,
    quantise: Granularity = PLAIN.granularity,
    **reading: Any,  # noqa: ANN401
) -> CoreDesign:
    """The design of a policy; ConfigError for what a core does not compute.

    reading: options of `artifact.load`.
    """
    source = SpikingSource.read(policy, "verilog", chip, quantise, **reading)
    return _design(source, board_named(board or DEFAULT_BOARD))


def _design(source: SpikingSource, board: Board) -> CoreDesign:
    codec = source.require_codec()
    name, program = program_for(source.artifact, source.chip, source.quantisation)
    return CoreDesign(codec, name, program, core_image(program, codec), board)


def program_for(
    artifact: Artifact, name: str | None, quantisation: Quantisation = PLAIN
) -> tuple[str, Program]:
    """The name of the chip, and the program, of a policy on a core.

    A core updates a layer when it is told to, so that a gated network runs gated, and the name says
    so where the chip advances its layers otherwise; None is the chip of its training.
    """
    name = chip_of(artifact) if name is None else name
    on, clock = chip_named(name), own_clock(artifact.convention)
    if on.clock is None and clock not in on.clocks:
        name += f"{',' if ':' in name else ':'}clock={clock}"
    return name, compile_program(artifact, chip_named(name), quantisation)


def export_verilog(
    policy: str,
    path: Path | None,
    *,
    chip: str | None = None,
    board: str = DEFAULT_BOARD,
    quantise: Granularity = PLAIN.granularity,
    observations: int = 1000,
    env: str | None = None,
    force: bool = False,
) -> ExportResult:
    """Write a spiking policy as Verilog: a core, a top module, memories, a Makefile, a host.

    path: path of the folder.
    chip: whose integers the core computes; None is that of its training, or the default.
    board: board that the top module is for.
    quantise: whether neurons have scales of their own.
    observations: observations of an episode, of which the test benches have the first control
        steps.
    env: in which the episode is played; None is what the policy names, of ours.
    force: whether files are replaced that no export wrote, or that were changed since.

    Raises ConfigError for a program that the core does not compute, RuleError where it is larger
    than the board, both before a file is written.
    """
    folder = require_output(path, "a folder", "build/walker")
    if any(letter.isspace() for letter in str(folder.resolve())):
        raise ConfigError(
            f"-o {folder}: make and Verilator cannot build in a folder with spaces in its path. "
            "Name another."
        )
    on = board_named(board)
    source = SpikingSource.read(policy, "verilog", chip, quantise)
    made = _design(source, on)
    made.use.check()
    inputs = (source.file, policy)
    check_output_folder("-o", folder, (RECORD, MAKEFILE), inputs, force, is_export)
    check_unchanged("-o", folder, force)
    origin = f"{source.origin}, on {made.chip}{source.scales}"
    seen, recorded = source.episode(made.program, observations, env)
    texts = {
        **core_files(made.image, origin),
        **board_files(made.image, made.codec, on, origin, seen),
    }
    check_output_folder("-o", folder, texts, inputs, force, is_export)
    record = VerilogFolder(
        folder=folder,
        policy=zoo.name_in_exports(source.file),
        sha256=zoo.sha256(source.file),
        chip=made.chip,
        board=on.name,
        files=sums_of(texts),
        quantise=quantise,
    )
    write_folder(texts, record)
    raster = made.codec.encode_episode(seen)
    clocks = clocks_of(made.image, raster[:_COUNTED]).sum(axis=1)
    events = raster.reshape(len(raster), -1).sum(axis=1)
    named = named_env(source.artifact)
    world = f" --env {quote(env)}" if env else "" if named else " --env ENV"
    lines = (
        *made.lines,
        f"{'input events':<26} {events.mean():>7,.1f}, at most {events.max():,}",
        f"{'clocks':<26} {clocks.mean():>7,.0f}, at most {clocks.max():,} in {len(clocks)} control "
        f"steps: {1e6 * clocks.max() / on.clock_hz:,.0f} µs at {on.clock_hz / 1e6:g} MHz, and the "
        "UART",
        f"of a control step, means of {recorded}",
        *made.program.remarks,
        f"wrote {folder}: {len(texts) + 1} files for {on.title}",
        f"build it: make -C {quote(str(folder))} {' '.join(_targets(on, made.use))}",
        f"let it drive: spikedeploy run {quote(policy)}{world} --via {quote(str(folder))}",
    )
    counted = {"mean": float(clocks.mean()), "most": int(clocks.max()), "of": len(clocks)}
    facts = {"chip": made.chip, "board": on.name, "use": made.record, "clocks": counted}
    facts |= {"recorded": recorded, "remarks": list(made.program.remarks)}
    return ExportResult(folder, (*texts, RECORD), (), facts, lines)


def _targets(on: Board, use: Use) -> tuple[str, ...]:
    """Targets of make for a board."""
    if on.device.family != "ice40":
        return "lint", "sim", "pins", "bit"
    return ("lint", "sim", "netlist", "bit", *(() if use.large_rams else ("bitcheck",)))
