"""Files around a core on a board: top module, UART, constraints, Makefile, host, and costs."""

import json
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikedeploy.exporters.rendering import render
from spikedeploy.exporters.to_program import HOST_CODEC, as_rows, host_terms, plain_record, script
from spikedeploy.exporters.verilog.bench import (
    BENCH,
    RecordedSteps,
    bench_files,
    episode_record,
    record,
)
from spikedeploy.exporters.verilog.boards import Board
from spikedeploy.exporters.verilog.eda_tools import TOOLS
from spikedeploy.exporters.verilog.image import CoreImage
from spikedeploy.exporters.verilog.resources import Buffer, Use, predict
from spikedeploy.exporters.verilog.to_verilog import template
from spikedeploy.runtime.codec.codec import Codec
from spikedeploy.runtime.compiler.program import Program

MARK = "exported by spikedeploy as Verilog"
# copied as they are
_SAME = (
    *("uart.v", "link.v", "link.py", "host.py"),
    *("pins.py", "compare.py", "decompiled.py", "report.py"),
)
_FILLED = ("top.v", "pins_main.cpp", "Makefile", "README.md")
_EPISODE_STEPS = 100
# updates of neurons that the bench checks, about, and its timesteps
_UPDATES = 10_000
_LEAST_STEPS, _MOST_STEPS = 40, 300


def board_files(
    image: CoreImage,
    codec: Codec,
    board: Board,
    origin: str,
    observation: NDArray[np.float64],
    seed: int = 0,
) -> dict[str, str]:
    """Text of the files around a core, by name; RuleError where it is too large for the board.

    origin: where the program comes from, for comments.
    observation: (S, obs) of one episode from its beginning, of which the vectors are made.
    seed: of an encoder that is random.
    """
    use, buffer = predict(image, board), Buffer(image.words)
    use.check()
    buffer.check()
    family = board.device.family
    states = f"chparam -set STATE_IN_SPRAM {int(use.states_in_large_ram)} policy_core;"
    values = {
        "mark": MARK,
        "origin": origin,
        "board": board,
        "ports": board.ports,
        "family": family,
        "constraints": board.constraints_name,
        "bitstream": "policy.bin" if family == "ice40" else "policy.bit",
        "tools": [tool for name, tool in TOOLS.items() if name != "make"],
        "parameters": states,
        "programmer": _PROGRAMMERS[board.program[0].split()[0]],
        "link": buffer,
        "use": use,
        "image": image,
    }
    steps = int(np.clip(_UPDATES // image.neurons, _LEAST_STEPS, _MOST_STEPS)) // codec.timesteps
    raster = codec.encode_episode(observation[: max(1, steps)], seed)
    recorded = record(image, raster, episodes={0})
    episode = episode_record(image, codec, observation[:_EPISODE_STEPS], seed)
    return {
        **{name: template(name) for name in _SAME},
        HOST_CODEC: script(HOST_CODEC),
        **{name: render(__package__, name, **values) for name in _FILLED},
        board.constraints_name: board.constraints,
        "policy.json": as_rows(host_record(image.program, codec, image, board, origin)),
        BENCH: template(BENCH),
        **bench_files(image, recorded),
        "episode.json": as_rows(episode),
        "costs.json": json.dumps(costs_record(image, board, use, recorded), indent=2) + "\n",
    }


_PROGRAMMERS = {
    "iceprog": "apt-get install fpga-icestorm",
    "openFPGALoader": "apt-get install openfpgaloader",
}


def costs_record(
    image: CoreImage, board: Board, use: Use, recorded: RecordedSteps
) -> dict[str, Any]:
    """Return the predicted cells and time of the core on the board; builds add their results."""
    clocks, tokens = recorded.clocks.tolist(), recorded.tokens
    # a request and a reply have 5 bytes beside tokens and words, and a byte has 10 bits on the line
    line = [10 * (10 + 2 * len(step) + 4 * image.words) / board.baud for step in tokens]
    return {
        "board": board.name,
        "device": board.device.title,
        "clock_hz": board.clock_hz,
        "timestep": {
            "recorded": len(clocks),
            "clocks": {"mean": float(np.mean(clocks)), "most": max(clocks)},
            "core_us": {
                "mean": 1e6 * float(np.mean(clocks)) / board.clock_hz,
                "most": 1e6 * max(clocks) / board.clock_hz,
            },
            "uart_us": {"mean": 1e6 * float(np.mean(line)), "most": 1e6 * max(line)},
        },
        "predicted": use.record(),
    }


def host_record(
    program: Program, codec: Codec, image: CoreImage, board: Board, origin: str
) -> dict[str, Any]:
    """Return the record that host.py reads: the codec, the words, and their use."""
    buffer = Buffer(image.words)
    return {
        "format": MARK,
        "policy": origin,
        "board": board.name,
        "link": {
            "baud": board.baud,
            "tokens": buffer.tokens_most,
            "words": buffer.words_most,
            "timestep": image.words,
        },
        "state": program.convention.state,
        "codec": plain_record(codec.to_record()),
        "outputs": [{**vars(output), "words": output.words} for output in image.outputs],
        **host_terms(program),
    }
