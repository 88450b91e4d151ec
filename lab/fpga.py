r"""Policies on FPGAs: states and returns compared, clocks, cells, frequencies; docs/fpga.md.

    python -m lab fpga -o docs [--episodes 20] [--seeds 3] [--only hexapod/sparse]
        [--boards icebreaker,ulx3s] [--steps drive,netlist,build]

drive: the core drives episodes in simulation; every state is compared with the emulated chip, every
return with its own. netlist: what synthesis makes of the core for an iCE40 takes the inputs of
three of these episodes, every word is compared. build: synthesis, then place and route with three
seeds, for boards. What is found goes into results/fpga.json row by row, so that a run that is
stopped goes on where --only and --boards say; `-o docs` writes the tables of docs/fpga.md from all
of it. Needs make and Verilator for the first, Yosys for the others, nextpnr for the last
([how to](docs/fpga.md)); what no tool is there for is left out, and said. Exits with 1 where
something differs.
"""

import argparse
import json
import math
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikedeploy import zoo
from spikedeploy.comparison.evaluation import run_policy
from spikedeploy.console import say
from spikedeploy.envs.rollout import rollout
from spikedeploy.exporters.verilog.bench import record
from spikedeploy.exporters.verilog.boards import board, board_names
from spikedeploy.exporters.verilog.image import FORGET, STEP, CoreImage, core_image
from spikedeploy.exporters.verilog.simulation import (
    PROGRAM,
    RtlProcess,
    decode_words,
    image_process,
)
from spikedeploy.exporters.verilog.tools import make_variables, missing_tools
from spikedeploy.make_env import make_env
from spikedeploy.reports.table import ABSENT, markdown_text
from spikedeploy.runtime.artifact.artifact import Artifact, load
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.codec.delta import DeltaEncoder
from spikedeploy.runtime.emulator.controllers import SpikingController
from spikedeploy.runtime.errors import ConfigError, RuleError
from spikedeploy.runtime.files import read_json, write_json, write_text
from spikedeploy.seeds import EVALUATION
from spikedeploy.shipping.export_verilog import design, export_verilog, program_for
from spikedeploy.shipping.hardware_run import driver
from spikedeploy.shipping.sources import episode_of, named_env

Row = dict[str, Any]

ROOT = Path(__file__).resolve().parents[1]
RECORD = ROOT / "results/fpga.json"
STEPS = ("drive", "netlist", "build")
_NETLIST_EPISODES = 3
# where the core of every policy fits
_LARGEST = "ulx3s"
# bytes of a request, and of a reply, beside their tokens and words; bits of a byte on the line;
# tokens of a request
_FRAME, _BITS, _TOKENS = 5, 10, 128
# clocks of an event and of a spike, besides their synapses (docs/fpga.md, of the state machine)
_EVENT, _SPIKE = 4, 2


def main() -> int:
    """Measure what is asked for, and write the tables."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "docs", help="of fpga.md")
    parser.add_argument("--episodes", type=int, default=20)
    parser.add_argument("--seeds", type=int, default=3, help="of place and route, from 1")
    parser.add_argument("--only", default="", help="a policy, such as hexapod/sparse")
    parser.add_argument("--boards", default=",".join(board_names()), help="names, with commas")
    parser.add_argument("--steps", default=",".join(STEPS), help="drive, build, or '' for none")
    options = parser.parse_args()
    steps, boards = options.steps.split(","), options.boards.split(",")
    if unknown := set(steps) - {*STEPS, ""}:
        raise ConfigError(f"--steps {min(unknown)!r} is none of {', '.join(STEPS)}")
    names = [name for name in spiking() if options.only in ("", name)]
    for name in names if "drive" in steps else ():
        keep("drive", name, drive(name, options.episodes))
    for name in names if "netlist" in steps else ():
        keep("netlist", name, netlist(name))
    for name in names if "build" in steps else ():
        for each in boards:
            keep("build", f"{name} {each}", build(name, each, options.seeds))
    page = options.output / "fpga.md"
    text = page.read_text(encoding="utf-8")
    for place, table in tables(recorded()).items():
        text = put(text, place, table)
    write_text(page, text)
    print(f"wrote {page}")
    played = [*recorded()["drive"].values(), *recorded()["netlist"].values()]
    return int(any(row.get("differing") for row in played))


def spiking() -> list[str]:
    """Shipped policies that spike, for Loihi's kind of integers, convolutions apart."""
    names = [name for name in zoo.names() if file_of(name).suffix == ".nir"]
    return [name for name in names if not name.startswith(("chips/", "kart-eye/"))]


def file_of(name: str) -> Path:
    """The file of a shipped policy."""
    if (found := zoo.path(name)) is None:
        raise ConfigError(f"no policy {name!r} is shipped")
    return found


def recorded() -> dict[str, dict[str, Row]]:
    """All that was found, by step and name."""
    found = read_json(RECORD) if RECORD.is_file() else {}
    return {step: found.get(step, {}) for step in STEPS}


def keep(step: str, name: str, row: Row) -> None:
    """Enter a row into the record."""
    found = recorded()
    found[step][name] = row
    write_json(RECORD, found)
    print(json.dumps({name: row}), file=sys.stderr, flush=True)


def drive(name: str, episodes: int) -> Row:
    """The core of a policy in the closed loop; why not, where it is refused."""
    artifact = load(file_of(name))
    with tempfile.TemporaryDirectory() as folder:
        try:
            export_verilog(name, Path(folder), board=_LARGEST, observations=200)
        except (ConfigError, RuleError) as error:
            return {"refused": str(error)}
        seeds = range(EVALUATION, EVALUATION + episodes)
        with driver(Path(folder), name) as core:
            play = partial(run_policy, name, None, core.chip, seeds)
            found = core.beside_emulated(play(hardware=core), play)
        image = core_image(program_for(artifact, None)[1], artifact.codec)
        formula = clocks_of(image, artifact, Path(folder) / PROGRAM)
    clocks = np.array(core.states.clocks).reshape(-1, formula["timesteps"]).sum(axis=1)
    states = found.states
    return {
        "episodes": episodes,
        "control_steps": len(clocks),
        "numbers": states["numbers"],
        "differing": states["differing"],
        "unequal_returns": sum(a != b for a, b in zip(found.returns, found.emulated, strict=True)),
        "clocks": {"mean": float(clocks.mean()), "most": int(clocks.max())},
        "period": period_of(artifact),
        **formula,
    }


def period_of(artifact: Artifact) -> float:
    """Time of a control step [s]."""
    world: Any = make_env(named_env(artifact), {}).unwrapped
    period: float = world.CONTROL_DT
    return period


def clocks_of(image: CoreImage, artifact: Artifact, program: Path) -> Row:
    """Clocks of a timestep as a sum, fitted to an episode, and what enters it.

    coefficients: of 1, of input events and of spikes; a synapse takes one clock.
    residual: largest difference of a timestep from the sum [clocks].
    """
    seen, _ = episode_of(artifact, None, 1000, named_env(artifact))
    if artifact.codec is None:
        raise TypeError("a policy has a codec")
    rows, clocks = [], []
    lengths = image.rows.lengths
    raster = artifact.codec.encode_episode(seen)
    kept = artifact.convention.state == "kept"
    with image_process(program, image) as process:
        for inference in raster:
            if not kept:
                process.reset()
            for row in inference:
                axons = np.flatnonzero(row)
                found = process.step(axons.tolist())
                fired = np.flatnonzero(found.spikes)
                synapses = lengths[axons].sum() + lengths[image.axons + fired].sum()
                rows.append((1, len(axons), len(fired)))
                clocks.append(found.clocks - synapses)
    terms, wanted = np.array(rows, float), np.array(clocks, float)
    fitted, *_ = np.linalg.lstsq(terms, wanted, rcond=None)
    events = raster.reshape(len(raster), -1).sum(axis=1)
    return {
        "timesteps": artifact.codec.timesteps,
        "coefficients": [round(float(each), 2) for each in fitted],
        "residual": float(np.abs(terms @ fitted - wanted).max()),
        "events": float(events.mean()),
        "events_most": int(events.max()),
        "words": artifact.codec.timesteps * image.words,
    }


def bound_of(image: CoreImage, artifact: Artifact, silent: float) -> Row:
    """Most clocks and tokens that a control step can take, with every input at its worst.

    silent: clocks of a timestep without events and spikes
    """
    if artifact.codec is None:
        raise TypeError("a policy has a codec")
    lengths, encoder = image.rows.lengths, artifact.codec.encoder
    each, count = lengths[: image.axons] + _EVENT, np.ones(image.axons)
    if isinstance(encoder, DeltaEncoder):  # an observation moves up or down, and not both
        signs = (encoder.observed, 2, encoder.most)
        reduce = np.add if encoder.code == "unary" else np.maximum
        each, count = (reduce.reduce(x.reshape(signs), axis=2).max(1) for x in (each, count))
        sends = np.isfinite(encoder.step)  # others never do
        each, count = each[sends], count[sends]
    spiking = np.concatenate([np.full(a.size, a.spiking) for a in image.program.layers])
    spikes = ((lengths[image.axons :] + _SPIKE) * spiking).sum()
    timesteps = artifact.codec.timesteps
    return {
        "bound": int(timesteps * (silent + each.sum() + spikes)),
        "events_bound": int(timesteps * count.sum()),
        "forgets": int(artifact.convention.state == "reset"),
    }


def netlist(name: str, episodes: int = _NETLIST_EPISODES) -> Row:
    """What synthesis makes of a core, on the input spikes of episodes; why not, where refused."""
    artifact = load(file_of(name))
    if (codec := artifact.codec) is None:
        raise TypeError("a policy has a codec")
    with tempfile.TemporaryDirectory() as text:
        folder = Path(text)
        try:
            export_verilog(name, folder, observations=2)
        except (ConfigError, RuleError) as error:
            return {"refused": str(error)}
        words = ["make", "-s", "-C", text, *make_variables(), "policy_sim_netlist"]
        done = subprocess.run(words, capture_output=True, text=True, check=False)
        if done.returncode:
            raise ConfigError(f"{name}: the netlist cannot be built: {done.stderr[-300:]}")
        on, program = program_for(artifact, None)
        image = core_image(program, codec)
        rows: list[NDArray[np.uint8]] = []
        begins: list[int] = []
        for seed in range(EVALUATION, EVALUATION + episodes):
            controller = SpikingController(artifact, chip(on), ledger="none")
            walk = rollout(make_env(named_env(artifact), {}), controller, seed)
            begins.append(sum(map(len, rows)))
            rows.append(codec.encode_episode(walk.observation[:-1]))
        expected = record(image, np.concatenate(rows), "numpy", begins)
        size, differing = image.neurons, 0
        with RtlProcess(folder / "policy_sim_netlist", image.outputs, size, probe=False) as process:
            for tokens, wanted in zip(expected.tokens, expected.words, strict=True):
                if tokens[0] == FORGET:
                    process.reset()
                found = process.step(token for token in tokens if token < STEP).values
                ends = np.cumsum([output.words for output in image.outputs])[:-1]
                parts = np.split(np.array(wanted, "<u4"), ends)
                pairs = zip(image.outputs, parts, strict=True)
                differing += any((found[o.layer] != decode_words(w, o)).any() for o, w in pairs)
    return {"episodes": episodes, "timesteps": len(expected.words), "differing": differing}


def build(name: str, board_name: str, seeds: int) -> Row:
    """Cells, memories and frequencies of a policy on a board, as predicted and as built.

    predicted, built: as in costs.json; the second is missing where it does not fit, or no tool is
        there.
    """
    made = design(str(file_of(name)), None, board_name)
    if not made.use.fits:
        return {"predicted": made.record}
    family = board(board_name).device.family
    needed = ("yosys", f"nextpnr-{family}", "icepack" if family == "ice40" else "ecppack")
    if missing := missing_tools(*needed):
        say(f"{name} on {board_name} is not built: {', '.join(missing)} is not installed")
        return {"predicted": made.record}
    with tempfile.TemporaryDirectory() as text:
        folder = Path(text)
        export_verilog(name, folder, board=board_name, observations=2)
        for seed in range(1, seeds + 1):
            for stale in ("policy.asc", "policy.config"):  # of the seed before
                (folder / stale).unlink(missing_ok=True)
            words = ["make", "-s", "-C", text, *make_variables(), f"SEED={seed}", "bit"]
            done = subprocess.run(words, capture_output=True, text=True, check=False)
            if done.returncode:
                raise ConfigError(f"{name} on {board_name} cannot be built: {done.stderr[-300:]}")
        return read_json(folder / "costs.json")


def put(text: str, place: str, table: str) -> str:
    """The page with a table between the marks of its place."""
    start, end = f"<!-- {place} -->\n", f"<!-- end of {place} -->\n"
    head, rest = text.split(start)
    _, tail = rest.split(end)
    return f"{head}{start}{table}\n{end}{tail}"


def tables(found: Mapping[str, Mapping[str, Row]]) -> dict[str, str]:
    """The tables of the page, by place."""
    driven = {
        name: row | _bound(name, row["coefficients"][0])
        for name, row in found["drive"].items()
        if "refused" not in row
    }
    return {
        "drive": _table(_DRIVE, driven),
        "netlist": _table(_NETLIST, found["netlist"]),
        "build": _build_table(found["build"]),
        "latency": _table(_LATENCY, driven),
    }


def _bound(name: str, silent: float) -> Row:
    artifact = load(file_of(name))
    return bound_of(core_image(program_for(artifact, None)[1], artifact.codec), artifact, silent)


Columns = Mapping[str, Callable[[Row], str]]


def _clocks(row: Row) -> str:
    constant, event, spike = row["coefficients"]
    return f"{constant:g} + {event:g} events + {spike:g} spikes + synapses"


_DRIVE: Columns = {
    "episodes": lambda row: str(row["episodes"]),
    "control steps": lambda row: f"{row['control_steps']:,}",
    "numbers compared": lambda row: f"{row['numbers']:,}",
    "differ": lambda row: str(row["differing"]),
    "returns that differ": lambda row: str(row["unequal_returns"]),
}


_NETLIST: Columns = {
    "episodes": lambda row: str(row["episodes"]),
    "timesteps": lambda row: f"{row['timesteps']:,}",
    "timesteps with a word that differs": lambda row: str(row["differing"]),
}


def _microseconds(clocks: float) -> str:
    return f"{clocks / 12:,.0f}"


def _on_the_line(row: Row) -> str:
    """Time of all frames at 1 Mbaud, with the mean events, and with the most there can be [ms]."""
    found = []
    for events in (row["events"], row["events_bound"]):
        tokens = events + row["timesteps"] + row["forgets"]
        frames = 2 * _FRAME * math.ceil(tokens / _TOKENS)
        found.append(_BITS * (frames + 2 * tokens + 4 * row["words"]) / 1e3)
    return " (".join(f"{each:.2f}" for each in found) + ")"


_LATENCY: Columns = {
    "clocks of a timestep": _clocks,
    "clocks of a control step, mean, most seen": lambda row: (
        f"{row['clocks']['mean']:,.0f}, {row['clocks']['most']:,}"
    ),
    "bound": lambda row: f"{row['bound']:,}",
    "at 12 MHz, mean (bound) [µs]": lambda row: (
        f"{_microseconds(row['clocks']['mean'])} ({_microseconds(row['bound'])})"
    ),
    "UART besides, mean (bound) [ms]": _on_the_line,
    "control rate [Hz]": lambda row: f"{1 / row['period']:.0f}",
    "clock that it needs without the UART [kHz]": lambda row: (
        f"{row['bound'] / row['period'] / 1e3:,.0f}"
    ),
}


def _table(columns: Columns, rows: Mapping[str, Row]) -> str:
    cells = [[name, *(of(row) for of in columns.values())] for name, row in rows.items()]
    return markdown_text([["policy", *columns], *cells])


_BUILD = (
    "policy",
    "board",
    "cells",
    "predicted",
    "block RAMs",
    "large RAMs",
    "MHz, of three seeds",
)


def _build_table(rows: Mapping[str, Row]) -> str:
    """What each policy takes on each board; in bold what is too little."""
    lines = []
    for name, row in rows.items():
        policy, board_name = name.split()
        device, built = board(board_name).device, row.get("built", [])
        taken = {**row["predicted"], **(built[0] if built else {})}
        speeds = [each["mhz"] for each in built]
        lines.append(
            (
                policy,
                board_name,
                _share(taken["cells"], device.cells) if built else ABSENT,
                f"{row['predicted']['cells']:,}",
                _share(taken["block_rams"], device.block_rams),
                _share(taken["large_rams"], device.large_rams) if device.large_rams else ABSENT,
                f"{min(speeds):.1f} to {max(speeds):.1f}" if built else ABSENT,
            )
        )
    return markdown_text([_BUILD, *lines])


def _share(taken: int, there: int) -> str:
    text = f"{taken:,} of {there:,}"
    return f"**{text}**" if taken > there else text
