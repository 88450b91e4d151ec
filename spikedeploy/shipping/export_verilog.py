"""A policy as Verilog for a board: what is written, what it takes, and what is refused before."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from shlex import quote
from typing import Any

import numpy as np

from spikedeploy import zoo
from spikedeploy.exporters.c.packaging import MAKEFILE
from spikedeploy.exporters.verilog.board_files import board_files
from spikedeploy.exporters.verilog.boards import Board, board
from spikedeploy.exporters.verilog.image import CoreImage, core_image
from spikedeploy.exporters.verilog.model import clocks_of, tokens_of
from spikedeploy.exporters.verilog.resources import predict
from spikedeploy.exporters.verilog.to_verilog import core_files
from spikedeploy.outputs import check_output_folder
from spikedeploy.runtime.artifact.artifact import Artifact, load
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.chips.quantisation import PLAIN, Quantisation
from spikedeploy.runtime.codec.codec import GIVE_CODEC, Codec
from spikedeploy.runtime.compiler.compile import compile_program, own_clock
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.shipping.export_c import WrittenFolder
from spikedeploy.shipping.sources import (
    chip_of,
    episode_of,
    named_env,
    nir_file,
    on_chip,
    world_of,
)
from spikedeploy.shipping.verilog_folder import (
    RECORD,
    VerilogFolder,
    check_unchanged,
    is_export,
    sums_of,
    write_folder,
)

DEFAULT_BOARD = "icebreaker"
# control steps of which the clocks are counted, by the model in Python
_COUNTED = 50


@dataclass(frozen=True)
class CoreDesign:
    """A policy on a core, on a board; nothing is written yet.

    chip: whose integers the core computes.
    """

    artifact: Artifact
    codec: Codec
    chip: str
    program: Program
    image: CoreImage
    board: Board


def design(
    file: Path,
    chip_name: str | None,
    board_name: str | None,
    quantisation: Quantisation = PLAIN,
    **reading: Any,  # noqa: ANN401
) -> CoreDesign:
    """The design of a policy's file; ConfigError for what a core does not compute.

    reading: options of `artifact.load`.
    """
    on = board(board_name or DEFAULT_BOARD)
    artifact = load(file, **reading)
    if artifact.codec is None:
        raise ConfigError(
            f"{file} has no codec (observation to spikes), so that no host could ask the core for "
            f"actions. {GIVE_CODEC}."
        )
    name, program = program_for(artifact, chip_name, quantisation)
    image = core_image(program, artifact.codec)
    return CoreDesign(artifact, artifact.codec, name, program, image, on)


def export_verilog(
    policy: str,
    chip_name: str | None,
    board_name: str | None,
    folder: Path | None,
    observations: int = 1000,
    force: bool = False,
    env: str | None = None,
    quantisation: Quantisation = PLAIN,
) -> WrittenFolder:
    """Write a spiking policy as Verilog: a core, a top module, memories, a Makefile, a host.

    policy: .nir file, shipped policy, run folder, its name under runs/, or "last".
    chip_name: whose integers the core computes; None is that of its training, or the default.
    board_name: that the top module is for; None is DEFAULT_BOARD.
    folder: to write to.
    observations: of an episode, of which the test benches have the first control steps.
    force: whether files are replaced that no export wrote, or that were changed since.
    env: in which the episode is played; None is what the policy names, of ours.
    quantisation: whether neurons have scales of their own.

    Raises ConfigError for a program that the core does not compute, RuleError where it is larger
    than the board, both before a file is written.
    """
    if folder is None:
        raise ConfigError("--to verilog writes a folder: name it, as in -o build/walker")
    if any(letter.isspace() for letter in str(folder.resolve())):
        raise ConfigError(
            f"-o {folder}: make and Verilator cannot build in a folder with spaces in its path. "
            "Name another."
        )
    file = nir_file(policy, "verilog")
    made = design(file, chip_name, board_name, quantisation)
    image, on, inputs = made.image, made.board, (file, policy)
    predict(image, on).check()
    check_output_folder("-o", folder, (RECORD, MAKEFILE), inputs, force, is_export)
    check_unchanged("-o", folder, force)
    shipped = zoo.name_in_exports(file)
    origin = f"{shipped}, sha256 {zoo.sha256(file)[:16]}, on {on_chip(made.chip, quantisation)}"
    where = world_of(policy, made.artifact)
    seen, source = episode_of(made.artifact, made.program.chip, observations, where, env)
    raster = made.codec.encode_episode(seen)
    texts = {
        **core_files(image, origin),
        **board_files(image, made.codec, on, origin, seen),
    }
    check_output_folder("-o", folder, texts, inputs, force, is_export)
    names = (shipped, zoo.sha256(file), made.chip, on.name)
    scales = quantisation.granularity
    write_folder(texts, VerilogFolder(folder, *names, sums_of(texts), scales))
    begins = range(_COUNTED) if made.artifact.convention.state == "reset" else ()
    timesteps = clocks_of(image, tokens_of(raster[:_COUNTED], begins))
    clocks = np.array(timesteps).reshape(-1, raster.shape[1]).sum(axis=1)
    use = use_of(made)
    events = raster.reshape(len(raster), -1).sum(axis=1)
    world = f" --env {quote(env)}" if env else "" if named_env(made.artifact) else " --env ENV"
    lines = (
        *use.lines,
        f"{'input events':<26} {events.mean():>7,.1f}, at most {events.max():,}",
        f"{'clocks':<26} {clocks.mean():>7,.0f}, at most {clocks.max():,} in {len(clocks)} control "
        f"steps: {1e6 * clocks.max() / on.clock_hz:,.0f} µs at {on.clock_hz / 1e6:g} MHz, and the "
        "UART",
        f"of a control step, means of {source}",
        *made.program.remarks,
        f"wrote {folder}: {len(texts) + 1} files for {on.title}",
        f"build it: make -C {quote(str(folder))} {' '.join(_targets(on, use.record))}",
        f"let it drive: spikedeploy run {quote(policy)}{world} --via {quote(str(folder))}",
    )
    counted = {"mean": float(clocks.mean()), "most": int(clocks.max()), "of": len(clocks)}
    facts = {"chip": made.chip, "board": on.name, "use": use.record, "clocks": counted}
    facts |= {"recorded": source, "remarks": list(made.program.remarks)}
    return WrittenFolder(folder, (*texts, RECORD), facts, lines)


def _targets(on: Board, use: Mapping[str, Any]) -> tuple[str, ...]:
    """What make can build and compare for a board."""
    if on.device.family != "ice40":
        return "lint", "sim", "pins", "bit"
    back = () if use["large_rams"] else ("bitcheck",)
    return ("lint", "sim", "netlist", "bit", *back)


def program_for(
    artifact: Artifact, chip_name: str | None, quantisation: Quantisation = PLAIN
) -> tuple[str, Program]:
    """The name of the chip, and the program, of a policy on a core.

    A core updates a layer when it is told to, so that a gated network runs gated, and the name says
    so where the chip advances its layers otherwise.
    """
    name = chip_of(artifact) if chip_name is None else chip_name
    on, clock = chip(name), own_clock(artifact.convention)
    if on.clock is None and clock not in on.clocks:
        name += f"{',' if ':' in name else ':'}clock={clock}"
    return name, compile_program(artifact, chip(name), quantisation)


@dataclass(frozen=True)
class UseOfBoard:
    """A policy's use of a board's FPGA, predicted before synthesis.

    fits: whether there is enough of everything.
    lines: for a terminal; record: as data.
    """

    fits: bool
    lines: tuple[str, ...]
    record: dict[str, Any]


def use_of_board(
    file: Path,
    chip_name: str | None,
    board_name: str,
    **reading: Any,  # noqa: ANN401
) -> UseOfBoard:
    """The use that a policy's file would make of a board, whether it fits or not."""
    return use_of(design(file, chip_name, board_name, **reading))


def use_of(made: CoreDesign) -> UseOfBoard:
    """The use of a design."""
    use, on = predict(made.image, made.board), made.board
    verdict = "fits on" if use.fits else "does not fit on"
    head = f"{verdict} {on.title} ({on.device.title}), as predicted before synthesis"
    record = {"board": on.name, "chip": made.chip, **use.record()}
    return UseOfBoard(use.fits, (head, *use.lines()), record)
