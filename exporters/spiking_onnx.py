"""A spiking policy as one ONNX file: a control step (observation, states) -> (action, states).

    observation (B, obs) -> encoder -> layers, T timesteps written out -> mean, tanh -> action
    lif1.membrane (B, N)                ->                 next.lif1.membrane (B, N)

The inference is unrolled: its T timesteps follow one another in the graph, which has no loop. What
passes from one control step to the next comes in and goes out: levels of a delta code, and where
the convention keeps states also currents, membranes and spikes that are still under way. All begin
at 0. It is the program without rounding, chip `ideal`, in float64: it equals the float twin up to
the order in which float64 adds up.
"""

import json
from pathlib import Path

import numpy as np
import onnx
from numpy.typing import NDArray

from spikedeploy.exporters.c.plan import Plan
from spikedeploy.exporters.check import LargestDifference, ParityCheck
from spikedeploy.exporters.onnx_encoders import check_codec, encoded
from spikedeploy.exporters.onnx_graph import OBSERVATION, OUTPUTS, OnnxGraph
from spikedeploy.runtime.artifact.artifact import Artifact
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.chips.layer import Layer
from spikedeploy.runtime.codec.codec import Codec
from spikedeploy.runtime.compiler.compile import compile_program
from spikedeploy.runtime.emulator.float_machine import FloatMachine
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.metadata import Provenance
from spikedeploy.trainers.atomic import replacing
from spikedeploy.trainers.onnx_session import session

KIND = "snn-step"
NEXT = "next."  # what the names of states that go out begin with
_TOLERANCE = 1e-9  # of an action, or of the largest score: float64 sums in different order

Rows = dict[str, list[str]]  # name of a source -> its spikes or membranes (B, N) in each timestep


def spiking_to_onnx(artifact: Artifact, path: str | Path) -> Path:
    """Write the policy to `path` and return it."""
    path = Path(path)
    model = _model(artifact, path.stem)
    with replacing(path) as temporary:
        temporary.write_bytes(model.SerializeToString(deterministic=True))
    return path


def checks(artifact: Artifact, path: Path, observations: NDArray[np.float64]) -> list[ParityCheck]:
    """Compare the file with the float twin on successive observations (S, obs) of an episode."""
    codec = _codec(artifact)
    twin, levels, network = FloatMachine(artifact, "none"), codec.encoder.start(0), session(path)
    names = [each.name for each in network.get_outputs()]
    states = {each.name: np.zeros((1, each.shape[1])) for each in network.get_inputs()[1:]}
    apart = LargestDifference()
    for row in observations[:, None]:
        scores = codec.scores(twin.infer(codec.encode(row, levels)))
        expected = np.tanh(scores) if codec.squash == "tanh" else scores
        found, *left = network.run(names, {OBSERVATION: row, **states})
        states = {n.removeprefix(NEXT): v for n, v in zip(names[1:], left, strict=True)}
        unit = max(1.0, float(np.abs(expected).max()))
        apart.add(found / unit, expected / unit)
    detail = f"largest difference {apart.largest:.1e}, limit {_TOLERANCE:.0e}"
    name = "scores" if codec.chooses else "actions"
    said = f"{len(observations):,} successive observations, {detail}"
    return [ParityCheck(f"{name}: float twin = ONNX Runtime", apart.within(_TOLERANCE), said)]


def _codec(artifact: Artifact) -> Codec:
    if artifact.codec is None:
        raise ConfigError(
            "--to onnx: the file has no codec (observation to spikes), so it cannot act. Give it "
            "one with `spikedeploy run --from`; docs/own-network.md has it."
        )
    check_codec(artifact.codec)
    return artifact.codec


def _model(artifact: Artifact, name: str) -> onnx.ModelProto:
    codec, graph = _codec(artifact), OnnxGraph(np.float64)
    plan = Plan(compile_program(artifact, chip("ideal"), limits=False), codec)
    if plan.program.graded:
        raise ConfigError(
            f"--to onnx: layer {min(plan.program.graded)!r}: sigma-delta neurons are not written "
            "in ONNX. Train neurons that spike."
        )
    spikes, states = encoded(graph, codec)
    states |= _Network(graph, plan).run(spikes)
    head = "discrete" if codec.chooses else "continuous"
    squash = "Tanh" if codec.squash == "tanh" else "Identity"
    graph.node(squash, ["score"], OUTPUTS[head])
    for state, (value, width) in states.items():
        graph.next_state(f"{NEXT}{state}", value, width)
    widths = {state: width for state, (_, width) in states.items()}
    said = _properties(artifact.provenance or Provenance(""), name, head)
    more = {"timesteps": str(codec.timesteps), "states": json.dumps(widths)}
    actions = plan.program.outputs[0].size
    return graph.model(
        codec.encoder.observed, actions, head, {**said, **more, "sha256": graph.sha256()}
    )


def _properties(origin: Provenance, name: str, head: str) -> dict[str, str]:
    """Where the policy comes from, as in the files of float policies."""
    said = {"env": origin.env, "recipe": origin.recipe, "seed": origin.seed, "steps": origin.steps}
    own = {"created": origin.created, "version": origin.version, "name": name, "head": head}
    return {"kind": KIND, **{key: str(value) for key, value in {**said, **own}.items()}}


class _Network:
    """Writes the layers of a plan and their readout, one timestep after another."""

    def __init__(self, graph: OnnxGraph, plan: Plan) -> None:
        self._graph, self._plan = graph, plan
        self._kept = plan.program.convention.state == "kept"
        self._rows: Rows = {name: [] for name in plan.names}
        self._states: dict[str, tuple[str, int]] = {}  # name -> its value now, and its width
        graph.constant("zero", 0.0)
        for layer in plan.program.layers:
            self._constants(layer)
        self._bias = self._readout_constants()
        self._begin()

    def run(self, spikes: list[str]) -> dict[str, tuple[str, int]]:
        """Add all timesteps, up to "score"; return the states after the last that are kept."""
        total = ""
        for t, arriving in enumerate(spikes):
            self._rows[self._plan.program.input].append(arriving)
            for layer, lags in zip(self._plan.program.layers, self._plan.program.lags, strict=True):
                self._rows[layer.name].append(self._step(layer, lags, t))
            output = self._output(t)
            total = self._graph.node("Add", [total, output], f"host:{t}.total") if t else output
        count = self._graph.constant("timesteps", float(len(spikes)))
        self._graph.node("Div", [total, count], "score")
        return {**self._states, **self._under_way(len(spikes))} if self._kept else {}

    def _constants(self, layer: Layer) -> None:
        add, name = self._graph.constant, layer.name
        for k, synapses in enumerate(layer.synapses):
            add(f"{name}.weight{k}", synapses.weight)
        add(f"{name}.bias", layer.bias[None])
        add(f"{name}.leak", layer.voltage_bias)
        add(f"{name}.current_decay", layer.current_decay)
        add(f"{name}.membrane_decay", layer.membrane_decay)
        if layer.spiking:
            add(f"{name}.threshold", layer.threshold)

    def _readout_constants(self) -> str:
        program = self._plan.program
        for k, term in enumerate(self._plan.terms):
            if term.weight is not None:
                self._graph.constant(f"host:weight{k}", term.weight)
        if program.outlets:
            return self._graph.constant("host:bias", program.outlets[0].bias[None])
        bias = 0.0 if program.readout is None else program.readout.bias[None]
        return self._graph.constant("host:bias", bias)

    def _begin(self) -> None:
        """Where states begin: at those of the step before, or at 0."""
        for layer in self._plan.program.layers:
            for state in (["current"] if layer.current_decay.any() else []) + ["membrane"]:
                name = f"{layer.name}.{state}"
                value = self._graph.state(name, layer.size) if self._kept else "zero"
                self._states[name] = (value, layer.size)
        if self._kept:
            for source, slots in self._plan.slots.items():
                for late in range(1, slots):
                    self._graph.state(_late(source, late), self._plan.sizes[source])

    def _row(self, source: str, t: int) -> str:
        """What a source puts out in a timestep; "" where that is nothing, before the first."""
        if t >= 0:
            return self._rows[source][t]
        return _late(source, -t) if self._kept else ""

    def _under_way(self, timesteps: int) -> dict[str, tuple[str, int]]:
        """Rows that arrive in the next control step."""
        return {
            _late(source, late): (self._row(source, timesteps - late), self._plan.sizes[source])
            for source, slots in self._plan.slots.items()
            for late in range(1, slots)
        }

    def _step(self, layer: Layer, lags: tuple[int, ...], t: int) -> str:
        """Add a timestep of a layer; return its spikes, or its membranes where it has none."""
        node, at = self._graph.node, f"{layer.name}.{t}"
        drive = self._arriving(layer, lags, t)
        if f"{layer.name}.current" in self._states:
            # I = a I + W s
            kept = self._decayed(layer.name, "current", at)
            drive = node("Add", [kept, drive], f"{at}.current")
            self._states[f"{layer.name}.current"] = (drive, layer.size)
        # V = b V + I + leak
        kept = self._decayed(layer.name, "membrane", at)
        driven = node("Add", [kept, drive], f"{at}.driven")
        membrane = node("Add", [driven, f"{layer.name}.leak"], f"{at}.membrane")
        if not layer.spiking:
            self._states[f"{layer.name}.membrane"] = (membrane, layer.size)
            return membrane
        return self._fired(layer, membrane, at)

    def _fired(self, layer: Layer, membrane: str, at: str) -> str:
        """Add the spikes of a timestep and the resets."""
        node, threshold = self._graph.node, f"{layer.name}.threshold"
        above = node("Greater", [membrane, threshold], f"{at}.above")
        after = "zero"
        if self._plan.program.convention.reset == "subtract":
            after = node("Sub", [membrane, threshold], f"{at}.less")
        left = node("Where", [above, after, membrane], f"{at}.left")
        self._states[f"{layer.name}.membrane"] = (left, layer.size)
        return self._graph.floats(above, f"{at}.spikes")

    def _decayed(self, name: str, state: str, at: str) -> str:
        before, _ = self._states[f"{name}.{state}"]
        return self._graph.node("Mul", [f"{name}.{state}_decay", before], f"{at}.{state}_left")

    def _arriving(self, layer: Layer, lags: tuple[int, ...], t: int) -> str:
        total = f"{layer.name}.bias"
        for k, (synapses, lag) in enumerate(zip(layer.synapses, lags, strict=True)):
            if row := self._row(synapses.source, t - lag):
                at = f"{layer.name}.{t}.{k}"
                sums = self._graph.node("MatMul", [row, f"{layer.name}.weight{k}"], f"{at}.sums")
                total = self._graph.node("Add", [total, sums], f"{at}.arriving")
        return total

    def _output(self, t: int) -> str:
        """Add what the host receives in a timestep (B, act)."""
        total = self._bias
        for k, term in enumerate(self._plan.terms):
            if row := self._row(term.layer, t - term.lag):
                at = f"host:{t}.{k}"
                if term.weight is not None:
                    row = self._graph.node("MatMul", [row, f"host:weight{k}"], f"{at}.sums")
                total = self._graph.node("Add", [total, row], f"{at}.output")
        return total


def _late(source: str, late: int) -> str:
    """Name of the state that holds the spikes of a source so many timesteps ago."""
    return f"{source}.spikes-{late}"
