"""A compiled program as the files of a kit: its integers, an input, and what is expected of it.

program.json    the integers, the clock, the placement on cores, and what the host does
expected.json   input events, and currents, membranes and spikes after every chip timestep, as
                `spikedeploy verify` reads them
README.md       what to type
host.py, host_codec.py and a script for the chip's own tool, which read these files, stand in
exporters/kit/ and are copied verbatim
"""

import hashlib
import json
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikedeploy.exporters.to_xylo import places, specification
from spikedeploy.runtime.chips.layer import Layer
from spikedeploy.runtime.codec.codec import GIVE_CODEC, Codec
from spikedeploy.runtime.compiler.mapping import CoreMapping
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.convention import State
from spikedeploy.runtime.emulator.interpreter import Interpreter, LayerTrace
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.files import read_toml
from spikedeploy.runtime.traces.programs import program_record
from spikedeploy.runtime.traces.verdict import QUANTITIES

MARK = "spikedeploy export --to program"
PROGRAM, EXPECTED, EPISODE = "program.json", "expected.json", "episode.npz"
README, HOST, HOST_CODEC = "README.md", "host.py", "host_codec.py"
_FORMAT = 1
_KIT = Path(__file__).parent / "kit"


@dataclass(frozen=True)
class ChipTool:
    """The tool of a chip for which the kit has a script.

    script: its name in exporters/kit/.
    name: of the tool, as the files that its script writes have it.
    install: what installs it, for a terminal.
    offline: the part that runs without a board; empty where none does.
    needs: further requirements of the board, in sentences.
    board: for a terminal, what installs that and runs the script on the board.
    page: of docs/.
    delay: [timesteps] from a spike to its arrival, where it has only one; 0 where any.
    """

    script: str
    name: str
    install: str
    offline: str
    needs: str
    board: str
    page: str
    delay: int = 0


def script(name: str) -> str:
    """The text of a file in exporters/kit/."""
    return (_KIT / name).read_text(encoding="utf-8")


TOOLS = {
    chip: ChipTool(name=name, **tool)
    for name, tool in read_toml(_KIT / "tools.toml").items()
    for chip in tool.pop("chips")
}


def tool_of(chip_name: str) -> ChipTool:
    """The tool of a chip; ConfigError where the kit has no script for it."""
    if chip_name not in TOOLS:
        raise ConfigError(
            f"--to program: there is no script for {chip_name}; there is one for each of "
            f"{', '.join(TOOLS)}. Choose one of them with --chip."
        )
    return TOOLS[chip_name]


@dataclass(frozen=True, eq=False)
class ChipRun:
    """A program as a chip runs it: all neurons update in each timestep, from the first on.

    program: with biases as weights of axons of the input, behind those that it had: all that the
        host injects. Delays are those from a spike to its arrival; no layer waits to start.
    timesteps: of a control step, or of the run of a raster.
    state: "reset" where each control step begins from zero states; else they go on.
    inject: the host's rows go into so many of them, from the first on.
    windows: for each layer the timesteps after which the host reads it.
    biases: for each axon of a bias the timesteps in which it spikes.
    """

    program: Program
    timesteps: int
    inject: int
    windows: Mapping[str, slice]
    biases: tuple[slice, ...]
    state: State = "kept"

    def rows(self, spikes: NDArray[Any]) -> NDArray[np.uint8]:
        """Return the rows (timesteps, M) that the host injects for input spikes (inject, M)."""
        raster = np.zeros((self.timesteps, self.program.width), np.uint8)
        width = spikes.shape[1]
        raster[: len(spikes), :width] = spikes
        for axon, timesteps in enumerate(self.biases, start=width):
            raster[timesteps, axon] = 1
        return raster

    def run_raster(self, raster: NDArray[np.uint8]) -> dict[str, LayerTrace]:
        """Run the raster (T, M) through all control steps, from zero states.

        The batch is of inferences where states are reset in each, else of the whole run.
        """
        length = self.timesteps if self.state == "reset" else len(raster)
        parts = raster.reshape(-1, length, raster.shape[1])
        return Interpreter(self.program, len(parts)).run(parts)


def chip_run(program: Program, rows: int, state: State = "kept") -> ChipRun:
    """The schedule of a chip for windows of so many input rows of a program.

    state: of a control step; a raster is a single inference, in which none is reset.

    Raises ConfigError where the chip would have to hold a layer.
    """
    if program.clock == "gated" and any(layer.start for layer in program.layers):
        raise ConfigError(
            f"--to program: clock 'gated' updates each layer once in a row and holds it meanwhile, "
            f"which the tools of {program.chip.name} cannot do. Choose --clock free, or pipelined."
        )
    program = program.dense("the kit")
    timesteps = program.rows(rows)
    windows = {layer.name: program.window(layer, timesteps) for layer in program.layers}
    least = 1 if program.chip.delay else 0
    biased = [layer for layer in program.layers if layer.bias.any()]
    starts = [max(windows[layer.name].start - least, 0) for layer in biased]
    layers = [_with_bias_axons(layer, program, biased, least) for layer in program.layers]
    return ChipRun(
        program=replace(
            program,
            width=program.width + len(biased),
            layers=tuple(replace(layer, start=0) for layer in layers),
            clock="pipelined",
            inputs=(),
        ),
        timesteps=timesteps,
        inject=rows,
        windows=windows,
        biases=tuple(slice(first, first + rows) for first in starts),
        state=state,
    )


def check_delays(program: Program, tool: ChipTool) -> None:
    """Refuse delays that the tool lacks."""
    for layer in program.layers:
        for synapses in layer.synapses:
            if tool.delay and synapses.delay != tool.delay:
                raise ConfigError(
                    f"--to program: layers {synapses.source!r} -> {layer.name!r}: a delay of "
                    f"{synapses.delay} timesteps; {tool.name} delivers after {tool.delay}. Choose "
                    "--clock pipelined, or a chip of another tool."
                )


def _with_bias_axons(layer: Layer, program: Program, biased: Sequence[Layer], delay: int) -> Layer:
    """The layer without bias, its input with an axon for each biased layer."""
    rows = np.zeros((len(biased), layer.size), np.int64)
    if layer in biased:
        rows[biased.index(layer)] = layer.bias
    synapses = list(layer.synapses)
    from_input = [k for k, each in enumerate(synapses) if each.source == program.input]
    place = next((k for k in from_input if synapses[k].delay == delay), None)
    if place is None and rows.any():
        none = np.zeros((program.width, layer.size), np.int64)
        new = replace(synapses[0], source=program.input, weight=none, delay=delay)
        place = len(synapses)
        from_input, synapses = [*from_input, place], [*synapses, new]
    for k in from_input:
        weight = np.vstack([synapses[k].weight, rows if k == place else 0 * rows])
        synapses[k] = replace(synapses[k], weight=weight)
    return replace(layer, bias=np.zeros_like(layer.bias), synapses=tuple(synapses))


def program_text(
    run: ChipRun, clock: str, placement: CoreMapping | None, host: Mapping[str, Any], origin: str
) -> str:
    """The text of program.json.

    clock: of the program as it was compiled.
    host: codec and readout, as `host_record` has them; why there is none, under "missing".
    """
    program = run.program
    reads = sorted({(window.start, window.stop) for window in run.windows.values()})
    return as_rows(
        {
            "made_by": MARK,
            "format": _FORMAT,
            "source": origin,
            "tool": tool_of(program.chip.name).name,
            "clock": clock,
            "control_step": {
                "timesteps": run.timesteps,
                "state": run.state,
                "inject": [0, run.inject],
                "read": [reads[0][0], reads[-1][1]],
                "bias_axons": [[each.start, each.stop] for each in run.biases],
            },
            **program_record(program),
            **(_xylo(program) if program.chip.name.startswith("xylo") else {}),
            "placement": [] if placement is None else list(_place(placement)),
            "host": dict(host),
            "remarks": list(program.remarks),
        }
    )


def _xylo(program: Program) -> dict[str, Any]:
    """The arguments of Rockpool, and the first hidden neuron of each layer."""
    found = {"first": places(program.layers[:-1]), "specification": specification(program)}
    return {"xylo": found}


_CLOCKS = {
    "gated": "in each timestep the layers update one after the other, and a spike arrives in the "
    "timestep in which it is emitted",
    "pipelined": "all layers update in each timestep, and a spike arrives in the next one, so that "
    "each layer lags a timestep behind the one before it, in the next control step too",
    "free": "all layers update in each timestep, a spike arrives `delay` timesteps of its synapses "
    "later, and the host waits for it",
}


def clock_text(run: ChipRun, clock: str) -> str:
    """Describe the clock for those who drive a chip, in sentences."""
    more = run.timesteps - run.inject
    rows = f"{run.inject} rows of input take {run.timesteps} timesteps"
    if more:
        rows += f", {more} more, until the last layer has seen the last row"
    reads = ", ".join(
        f"`{name}` in {window.start} to {window.stop - 1}" for name, window in run.windows.items()
    )
    states = {
        "reset": "All states are zeroed before each control step, also those of spikes under way; "
        "the script does it between two of them.",
        "kept": "States go on from the first timestep to the last.",
    }
    return (
        f"`{clock}`: {_CLOCKS[clock]}. {rows}: counted from 0, the host injects in 0 to "
        f"{run.inject - 1}, and reads {reads}. {states[run.state]}"
    )


def expected_text(run: ChipRun, raster: NDArray[np.uint8], text: str, source: str) -> str:
    """The text of expected.json.

    raster: (T, M) of the whole run in chip timesteps, axons of biases included.
    text: of program.json.
    """
    events = np.argwhere(raster)
    counts = raster[tuple(events.T)]
    program = run.program
    return as_rows(
        {
            "made_by": MARK,
            "chip": program.chip.name,
            "source": source,
            "program": PROGRAM,
            "program_sha256": hashlib.sha256(text.encode()).hexdigest(),
            "timesteps": len(raster),
            "input_events": np.repeat(events, counts, axis=0).tolist(),
            "recorded": {
                name: _record_layer(program, layer)
                for name, layer in run.run_raster(raster).items()
            },
        }
    )


def _record_layer(program: Program, layer: LayerTrace) -> dict[str, Any]:
    """Return what a layer did, by quantity: (T, N); without floats, which no tool rounds alike."""
    spikes, currents = np.concatenate(layer.spikes), np.concatenate(layer.current)
    found: dict[str, Any] = {"spikes": spikes.astype(np.int64).tolist()}
    states = program.chip.arithmetic.state_bits
    if layer.membrane.dtype.kind != "f":
        found["membrane"] = np.concatenate(layer.membrane).tolist()
        each = [currents] if currents.ndim == 2 else list(currents.swapaxes(0, 1))
        if len(states) > 1:
            found |= {name: rows.tolist() for name, rows in zip(QUANTITIES, each, strict=False)}
    return {name: found[name] for name in QUANTITIES if name in found}


def host_record(program: Program, codec: Codec | None, run: ChipRun) -> dict[str, Any]:
    """Return the host's part as a record: the codec, and the terms of the outputs.

    A term reads its layer from timestep `from` on. Under "missing" is why a loop cannot be closed,
    where it cannot.

    program: as it was compiled.
    """
    if codec is None:
        gone = f"the file has no codec, so observations cannot become spikes. {GIVE_CODEC}"
        return {"missing": gone}
    if program.host:
        return {"missing": "its host integrates readouts in float64, which host.py does not"}
    record = host_terms(program)
    for term in record["terms"]:
        term["reads"] = "spikes" if program.layer(term["layer"]).spiking else "membrane"
        term["from"] = run.windows[term["layer"]].start
    return {"codec": plain_record(codec.to_record()), **record}


def host_terms(program: Program) -> dict[str, Any]:
    """Return the terms that the host adds up, in order, as Decoder of host_codec.py reads them.

    An output starts with `bias`, and each term adds (its layer's numbers `lag` timesteps ago, times
    `scale` where there is one) @ `weight` from element `first` on. `plain`: spikes of one layer
    leave, and the bias is added behind the product.
    """
    terms: list[dict[str, Any]] = []
    bias: list[float] = []
    for node in program.output_nodes:
        for term in node.terms:
            layer = program.layer(term.layer)
            scale = [] if layer.spiking else np.broadcast_to(layer.scale, (layer.size,)).tolist()
            terms.append(
                {
                    "layer": term.layer,
                    "first": len(bias),
                    "size": len(node.bias),
                    "lag": term.lag,
                    "scale": scale,
                    "weight": None if term.weight is None else term.weight.tolist(),
                }
            )
        bias += node.bias.tolist()
    plain = not (program.reads_membranes or program.host_outputs)
    return {"plain": plain, "bias": bias, "terms": terms}


class KitPlayer:
    """A policy acting through a chip run, by host_codec.py as in the kit.

    host: as of host_record.
    rows: (timesteps, M) that were injected in each control step.
    """

    def __init__(self, host: Mapping[str, Any], run: ChipRun) -> None:
        self._codec, self._terms, self._run = _host_codec(), host["terms"], run
        self._host = host
        self.reset(0)

    def reset(self, seed: int) -> None:
        """Start an episode."""
        self._encode = self._codec.Encoder(self._host["codec"])
        self._encode.reset(seed)
        self._decode = self._codec.Decoder(self._host)
        self._chip = Interpreter(self._run.program, 1)
        self.rows: list[NDArray[np.uint8]] = []

    def act(self, observation: NDArray[np.float64]) -> NDArray[Any]:
        """The action for an observation."""
        run = self._run
        if run.state == "reset":
            self._chip = Interpreter(run.program, 1)
        self.rows.append(run.rows(self._encode(observation)))
        found = self._chip.run(self.rows[-1][None])
        seen = [
            getattr(found[term["layer"]], term["reads"])[0, run.windows[term["layer"]]]
            for term in self._terms
        ]
        return np.asarray(self._decode(seen))


def _host_codec() -> Any:  # noqa: ANN401
    """The module host_codec.py of the kit."""
    spec = spec_from_file_location("host_codec", _KIT / HOST_CODEC)
    if spec is None or spec.loader is None:
        raise ImportError(HOST_CODEC)
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def _place(mapping: CoreMapping) -> Iterator[dict[str, Any]]:
    """Node -> its neurons on each core; nothing where the chip has no cores."""
    for each in mapping.placements:
        if each.cores and each.first is not None:
            edges = [min(k * each.block, each.neurons) for k in range(each.cores + 1)]
            yield {
                "node": each.name,
                "kind": each.kind,
                "cores": [
                    {"core": each.first + k, "neurons": [edges[k], edges[k + 1]]}
                    for k in range(each.cores)
                ],
            }


def plain_record(record: object) -> Any:  # noqa: ANN401
    """Convert a metadata tree to JSON types: arrays become lists, infinity null."""
    if isinstance(record, Mapping):
        return {name: plain_record(value) for name, value in record.items()}
    if isinstance(record, np.ndarray | np.generic):
        return plain_record(record.tolist())
    if isinstance(record, list | tuple):
        return [plain_record(each) for each in record]
    return None if isinstance(record, float) and math.isinf(record) else record


def as_rows(record: Mapping[str, Any]) -> str:
    """Return JSON with each list of numbers on one line."""
    text = json.dumps(record, indent=1, allow_nan=False)
    return re.sub(r"\[[\s\d.,e+\-]*\]", lambda found: "".join(found[0].split()), text) + "\n"
