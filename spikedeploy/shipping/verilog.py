"""A policy as Verilog for a board, and `run --via`: its core drives in simulation.

The folder has a record, export.json: what was exported, for which chip and board, and the SHA-256
of each file.
"""

import hashlib
import subprocess
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path, PurePosixPath
from shlex import quote
from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, Field, ValidationError

from spikedeploy import zoo
from spikedeploy.comparison.comparison import Comparison
from spikedeploy.console import say
from spikedeploy.emulation.rtl_backend import RtlBackend, StateComparison
from spikedeploy.exporters.c.packaging import MAKEFILE, write_texts
from spikedeploy.exporters.check import ExportResult
from spikedeploy.exporters.verilog.bench import clocks_of
from spikedeploy.exporters.verilog.board_files import MARK, board_files
from spikedeploy.exporters.verilog.boards import Board
from spikedeploy.exporters.verilog.boards import board as board_named
from spikedeploy.exporters.verilog.eda_tools import make_variables, require_tool
from spikedeploy.exporters.verilog.image import CoreImage, core_image
from spikedeploy.exporters.verilog.resources import Use, predict
from spikedeploy.exporters.verilog.simulation import PROGRAM, RtlProcess
from spikedeploy.exporters.verilog.to_verilog import core_files
from spikedeploy.outputs import check_output_folder, has_text
from spikedeploy.policies.registry import find
from spikedeploy.runtime.artifact.artifact import load
from spikedeploy.runtime.chips.chip import chip as chip_named
from spikedeploy.runtime.chips.quantisation import PLAIN, Granularity, Quantisation
from spikedeploy.runtime.codec.codec import Codec
from spikedeploy.runtime.compiler.compile import compile_program, own_clock
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.emulator.backend import BackendMaker
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.files import as_text, read_json
from spikedeploy.shipping.sources import SpikingSource, named_env, require_output

DEFAULT_BOARD = "icebreaker"
RECORD = "export.json"
_COUNTED = 50  # control steps of which the clocks are counted
_REMEDY = "export the policy again"
# what makes another program of a core; other Verilog makes another core, which is compared anyway
_OF_THE_PROGRAM = (".hex", ".vh")


# The design of a policy, before anything is written.


@dataclass(frozen=True)
class CoreDesign:
    """A policy on a core, on a board.

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
    return _design(SpikingSource.read(policy, "verilog", chip, quantise, **reading), board)


def _design(source: SpikingSource, board: str | None) -> CoreDesign:
    """The design of a source.

    A core updates a layer when it is told to, so that a gated network runs gated, and the name of
    the chip says so where the chip advances its layers otherwise.
    """
    on = board_named(board or DEFAULT_BOARD)
    codec, name = source.require_codec(), source.chip
    chip, clock = chip_named(name), own_clock(source.artifact.convention)
    if chip.clock is None and clock not in chip.clocks:
        name += f"{',' if ':' in name else ':'}clock={clock}"
    program = compile_program(source.artifact, chip_named(name), source.quantisation)
    return CoreDesign(codec, name, program, core_image(program, codec), on)


# The export.


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
    force: whether files are replaced that no export wrote.

    Raises ConfigError for a program that the core does not compute, RuleError where it is larger
    than the board, both before a file is written.
    """
    folder = require_output(path, "a folder", "build/walker")
    if any(letter.isspace() for letter in str(folder.resolve())):
        raise ConfigError(
            f"-o {folder}: make and Verilator cannot build in a folder with spaces in its path. "
            "Name another."
        )
    source = SpikingSource.read(policy, "verilog", chip, quantise)
    made = _design(source, board)
    made.use.check()
    inputs = (source.file, policy)
    check_output_folder("-o", folder, (RECORD, MAKEFILE), inputs, force, is_export)
    origin = f"{source.origin}, on {made.chip}{source.scales}"
    seen, recorded = source.episode(made.program, observations, env)
    texts = {
        **core_files(made.image, origin),
        **board_files(made.image, made.codec, made.board, origin, seen),
    }
    check_output_folder("-o", folder, texts, inputs, force, is_export)
    record = VerilogFolder(
        folder=folder,
        policy=zoo.name_in_exports(source.file),
        sha256=zoo.sha256(source.file),
        chip=made.chip,
        board=made.board.name,
        files={name: _sum(text.encode()) for name, text in texts.items()},
        quantise=quantise,
    )
    write_folder(texts, record)
    raster = made.codec.encode_episode(seen)
    clocks = clocks_of(made.image, raster[:_COUNTED]).sum(axis=1)
    counted = {"mean": float(clocks.mean()), "most": int(clocks.max()), "of": len(clocks)}
    facts = {"chip": made.chip, "board": made.board.name, "use": made.record, "clocks": counted}
    events, on = raster.reshape(len(raster), -1).sum(axis=1), made.board
    world = f" --env {quote(env)}" if env else "" if named_env(source.artifact) else " --env ENV"
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
    facts |= {"recorded": recorded, "remarks": list(made.program.remarks)}
    return ExportResult(folder, (*texts, RECORD), (), facts, lines)


def _targets(on: Board, use: Use) -> tuple[str, ...]:
    """Targets of make for a board."""
    if on.device.family != "ice40":
        return "lint", "sim", "pins", "bit"
    return ("lint", "sim", "netlist", "bit", *(() if use.large_rams else ("bitcheck",)))


# The folder of an export.


def _inside(name: str) -> str:
    path = PurePosixPath(name)
    if path.is_absolute() or ".." in path.parts:
        raise ValueError(f"{name} is elsewhere")
    return name


class VerilogFolder(BaseModel, frozen=True):
    """An export, all of which but the folder is in RECORD.

    folder: with the files.
    policy: what was exported, in words.
    sha256: of its file.
    chip: whose integers the core computes, with the clock in the name where it is not the chip's.
    board: board that the top module is for.
    files: name -> sha256 of what was written.
    quantise: granularity of its scales.
    """

    folder: Path = Field(exclude=True)
    policy: str
    sha256: str
    chip: str
    board: str
    files: dict[Annotated[str, AfterValidator(_inside)], str]
    quantise: Granularity = PLAIN.granularity


def is_export(folder: Path) -> bool:
    """True where the folder has an earlier export, or what one left that was killed."""
    return has_text(folder / RECORD, MARK)


def write_folder(texts: Mapping[str, str], written: VerilogFolder) -> None:
    """Write all files or none; those of an earlier export that this one has not are removed."""
    folder = written.folder
    stale = set(read_folder(folder).files) - set(texts) if is_export(folder) else ()
    record = as_text({"format": MARK, **written.model_dump()})
    write_texts({**texts, RECORD: record}, folder, RECORD)
    for name in stale:
        if not (path := folder / name).is_symlink():
            path.unlink(missing_ok=True)


def read_folder(folder: Path) -> VerilogFolder:
    """The export in a folder; ConfigError where there is none, or its record is damaged."""
    if not is_export(folder):
        raise ConfigError(
            f"{folder} is no folder that `spikedeploy export --to verilog` wrote: it has no "
            f"{RECORD} with its mark"
        )
    try:
        return VerilogFolder(**{**read_json(folder / RECORD, _REMEDY), "folder": folder})
    except ValidationError as error:
        fields = ", ".join(str(each["loc"][0]) for each in error.errors())
        raise ConfigError(f"{folder / RECORD} is damaged ({fields}): {_REMEDY}") from error


def check_folder(policy: Path, folder: Path) -> VerilogFolder:
    """The export of this policy's file; ConfigError where it is another's, or damaged."""
    found = read_folder(folder)
    if found.sha256 != zoo.sha256(policy):
        raise ConfigError(
            f"--via {folder} was exported from {found.policy}, and {policy} is another file: "
            f"{_REMEDY}, or run that one"
        )
    for name, recorded in found.files.items():
        if not (path := folder / name).is_file():
            raise ConfigError(f"--via {folder} is damaged, {name} is missing: {_REMEDY}")
        if name.endswith(_OF_THE_PROGRAM) and _sum(path.read_bytes()) != recorded:
            raise ConfigError(
                f"--via {folder}: {name} is not as exported, so that it is another program: "
                f"{_REMEDY}"
            )
    return found


def _sum(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def build_simulation(folder: Path) -> Path:
    """The program that simulates the core, built where it is missing or older than its sources.

    Raises ConfigError with what make said where it cannot be built.
    """
    make = require_tool("make")
    target = folder / PROGRAM
    if not target.exists():
        say(f"building {target} with Verilator")
    words = [make, "-s", "-C", str(folder), "-f", MAKEFILE, *make_variables(), PROGRAM]
    done = subprocess.run(words, capture_output=True, text=True, errors="replace", check=False)
    if done.returncode or not target.is_file():
        lines = [line.strip() for line in (done.stderr or done.stdout).splitlines() if line.strip()]
        why = next((line for line in lines if not line.startswith("make")), "make failed")
        raise ConfigError(f"--via {folder}: the simulation cannot be built: {why}")
    return target


# Episodes that the core drives.


@dataclass(frozen=True)
class CoreDriver:
    """A core in simulation that is ready to drive.

    folder: folder in which it was built.
    name: name of its row.
    chip: chip whose integers it computes.
    backend: makes the backend of a machine.
    states: to which every timestep is added.
    """

    folder: Path
    name: str
    chip: str
    backend: BackendMaker
    states: StateComparison

    def compare(self, played: Comparison, emulate: Callable[[], Comparison]) -> dict[str, Any]:
        """Play the episodes on the emulated chip as well; return both results as data.

        "equal" is True if no state differs, and every return to its last bit.
        """
        states = self.states.as_json()  # before a page plays episodes once more
        (row,), (emulated,) = played.rows, emulate().rows
        returns: Sequence[float] = list(row.returns)
        expected = list(emulated.returns)
        return {
            "folder": str(self.folder),
            "equal": not states["differing"] and returns == expected,
            "returns": returns,
            "emulated_returns": expected,
            **states,
        }


@contextmanager
def driver(folder: Path, policy: str) -> Iterator[CoreDriver]:
    """The core of a folder that `export --to verilog` wrote of this policy.

    Raises ConfigError where the folder is of another policy, is damaged, or cannot be built.
    """
    candidate = find(policy)
    if candidate.format != ".nir":
        raise ConfigError(f"--via {folder}: {policy} is no spiking policy in a file, so no core's")
    found = check_folder(Path(candidate.path), folder)
    artifact = load(candidate.path)
    program = compile_program(artifact, chip_named(found.chip), Quantisation(found.quantise))
    image, states = core_image(program, artifact.codec), StateComparison()
    with RtlProcess(build_simulation(folder), image) as process:
        backend = partial(RtlBackend, hardware=process, comparison=states)
        yield CoreDriver(folder, f"{candidate.name} in RTL", found.chip, backend, states)


def driven_lines(found: Mapping[str, Any]) -> tuple[str, ...]:
    """Lines for a terminal of what CoreDriver.compare found."""
    clocks, returns = found["clocks"], found["returns"]
    equal = sum(a == b for a, b in zip(returns, found["emulated_returns"], strict=True))
    return (
        f"Hardware: {found['folder']} in simulation, {found['timesteps']:,} timesteps of "
        f"{clocks['mean']:,.0f} clocks ({clocks['least']:,} to {clocks['most']:,}).",
        f"{found['differing']:,} of {found['numbers']:,} currents, membranes, spikes and outputs "
        f"differ from the emulated chip's; {equal} of {len(returns)} returns equal its own to the "
        "last bit.",
        *([f"First difference: {found['first']}."] if found["first"] else []),
    )
