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
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from spikedeploy.exporters.c.plan import Plan
from spikedeploy.exporters.check import ParityCheck, compare_floats
from spikedeploy.exporters.onnx_graph import OUTPUTS, OnnxGraph, Value
from spikedeploy.runtime.artifact.artifact import Artifact
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.chips.layer import Layer
from spikedeploy.runtime.codec.codec import GIVE_CODEC, Codec
from spikedeploy.runtime.codec.delta import LARGEST, PARTS, DeltaEncoder
from spikedeploy.runtime.codec.population import PopulationEncoder
from spikedeploy.runtime.codec.rate import LEVELS, RateEncoder
from spikedeploy.runtime.compiler.compile import compile_program
from spikedeploy.runtime.emulator.running_network import FloatMachine
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.metadata import Provenance
from spikedeploy.trainers.onnx_session import infer, initial_states, session

KIND = "snn-step"
LEVELS_STATE = "codec:levels"  # events of each observation that were sent, with their signs
_TOLERANCE = 1e-9  # of an action, or of the largest score: float64 sums in different order

States = dict[str, tuple[Value, int]]  # name -> value after the step, and its width


def spiking_to_onnx(artifact: Artifact, path: str | Path) -> Path:
    """Write the policy to `path` and return it."""
    path, codec, graph = Path(path), _codec(artifact), OnnxGraph(np.float64)
    program = compile_program(artifact, chip("ideal"), limits=False).dense("ONNX")
    if program.graded:
        raise ConfigError(
            f"--to onnx: rule graded: sigma-delta layer {min(program.graded)!r} is not written in "
            "ONNX. Train neurons that spike."
        )
    spikes, states = add_encoder(graph, codec)
    score, kept = _Network(graph, Plan(program, codec)).run(spikes, codec.score)
    states |= kept
    head = "discrete" if codec.chooses else "continuous"
    graph.node("Tanh" if codec.squash == "tanh" else "Identity", score, name=OUTPUTS[head])
    for name, (value, width) in states.items():
        graph.next_state(name, value, width)
    origin = artifact.provenance or Provenance("")
    names = ("env", "recipe", "seed", "steps", "created", "version")
    properties = {
        "kind": KIND,
        **{name: str(getattr(origin, name)) for name in names},
        "name": path.stem,
        "head": head,
        "timesteps": str(codec.timesteps),
        "states": json.dumps({name: width for name, (_, width) in states.items()}),
        "sha256": graph.sha256(),
    }
    return graph.write(path, codec.encoder.observed, program.outputs[0].size, head, properties)


def checks(artifact: Artifact, path: Path, observations: NDArray[np.float64]) -> list[ParityCheck]:
    """Compare the file with the float twin on successive observations (S, obs) of an episode."""
    codec = _codec(artifact)
    twin, levels, network = FloatMachine(artifact, "none"), codec.encoder.start(0), session(path)
    output, states = network.get_outputs()[0].name, initial_states(network)
    found, expected = [], []
    for row in observations[:, None]:
        scores = codec.scores(twin.infer(codec.encode(row, levels)))
        expected.append(np.tanh(scores) if codec.squash == "tanh" else scores)
        found.append(infer(network, [output], row, states)[0])
    wanted = np.concatenate(expected)
    unit = np.maximum(1.0, np.abs(wanted).max(axis=1, keepdims=True))
    name = f"{'scores' if codec.chooses else 'actions'}: float twin = ONNX Runtime"
    return [compare_floats(name, np.concatenate(found) / unit, wanted / unit, _TOLERANCE)]


def _codec(artifact: Artifact) -> Codec:
    """The codec; ConfigError for a code that is no function of the observation and of states."""
    codec = artifact.codec
    if codec is None:
        raise ConfigError(
            f"--to onnx: the file has no codec (observation to spikes), so it cannot act. "
            f"{GIVE_CODEC}."
        )
    encoder = codec.encoder
    if encoder.random:
        raise ConfigError(
            f"--to onnx: encoder {encoder.kind!r} draws random bytes by the generator of the chip, "
            "which ONNX has not. Train it with mode regular, or a population or delta code."
        )
    if not isinstance(encoder, DeltaEncoder | PopulationEncoder | RateEncoder):
        raise ConfigError(f"--to onnx: encoder {encoder.kind!r} is not written in ONNX.")
    return codec


def add_encoder(graph: OnnxGraph, codec: Codec) -> tuple[list[Value], States]:
    """Spikes (B, M) of each timestep, and states."""
    normaliser, encoder, timesteps = codec.normaliser, codec.encoder, codec.timesteps
    x = graph.normalised(normaliser.mean, normaliser.std, normaliser.clip)
    if isinstance(encoder, DeltaEncoder):
        return _delta(graph, encoder, x, timesteps)
    if isinstance(encoder, PopulationEncoder):
        return _population(graph, encoder, x, timesteps), {}
    if isinstance(encoder, RateEncoder):
        return _rate(graph, encoder, x, timesteps), {}
    raise TypeError(type(encoder).__name__)


def _delta(
    graph: OnnxGraph, encoder: DeltaEncoder, x: Value, timesteps: int
) -> tuple[list[Value], States]:
    """Events n where an observation has moved, and the levels q moved by them."""
    fine = (x / encoder.step * float(PARTS)).clip(float(LARGEST))
    parts = graph.node("Round", fine)
    signs = graph.constant(np.array([[1.0], [-1.0]]))
    channels = graph.constant(np.arange(1.0, encoder.most + 1))
    kind = "GreaterOrEqual" if encoder.code == "unary" else "Equal"
    levels, spikes = graph.state(LEVELS_STATE, encoder.observed), []
    for _ in range(timesteps):
        # e = X - 256 q      n = sign(e) min((|e| + 128) >> 8, most)    where |e| > threshold
        apart = parts - levels * float(PARTS)
        far = graph.node("Abs", apart)
        whole = graph.node("Floor", (far + PARTS / 2) / float(PARTS))
        number = graph.node("Min", whole, float(encoder.most))
        signed = graph.node("Sign", apart) * number
        events = graph.node("Where", far > float(encoder.threshold), signed, 0.0)
        levels = levels + events
        each = events.reshape(-1, encoder.observed, 1, 1) * signs
        flags = graph.node(kind, each, channels).reshape(-1, encoder.width)
        spikes.append(graph.floats(flags))
    return spikes, {LEVELS_STATE: (levels, encoder.observed)}


def _population(
    graph: OnnxGraph, encoder: PopulationEncoder, x: Value, timesteps: int
) -> list[Value]:
    """Spikes of neurons that integrate the drive of their receptive fields."""
    # A = exp(-1/2 ((x - mean) / std)^2)
    fields = (x.reshape(-1, encoder.observed, 1) - encoder.mean) / encoder.std
    drive = graph.node("Exp", fields * fields * -0.5).reshape(-1, encoder.width)
    threshold, membrane = graph.constant(encoder.threshold), drive
    spikes: list[Value] = []
    for t in range(timesteps):
        if t:
            # v = (v - threshold * s) + A
            membrane = membrane - threshold * spikes[-1] + drive
        spikes.append(graph.floats(membrane > threshold))
    return spikes


def _rate(graph: OnnxGraph, encoder: RateEncoder, x: Value, timesteps: int) -> list[Value]:
    """Carries of an accumulator to which the rate is added in each timestep."""
    share = graph.node("Clip", (x - encoder.low) / (encoder.high - encoder.low), 0.0, 1.0)
    rate = graph.node("Round", share * float(LEVELS))
    # c[t] = floor((n t + 128) / 256) ; s[t] = c[t + 1] - c[t]
    carried = [
        graph.node("Floor", (rate * float(t) + LEVELS / 2) / float(LEVELS))
        for t in range(timesteps + 1)
    ]
    return [after - before for before, after in pairwise(carried)]


class _Network:
    """Writer of the layers of a plan and their readout, one timestep after another."""

    def __init__(self, graph: OnnxGraph, plan: Plan) -> None:
        self._graph, self._plan, self._program = graph, plan, plan.program
        self._kept = plan.program.convention.state == "kept"
        self._rows: dict[str, list[Value]] = {name: [] for name in plan.names}
        self._states: States = {}
        self._late: dict[str, Value] = {}
        self._constants: dict[int, tuple[NDArray[np.generic], Value]] = {}
        if plan.program.host_outputs:
            bias = plan.program.host_outputs[0].bias[None]
        else:
            readout = plan.program.readout
            bias = np.zeros((1, 1)) if readout is None else readout.bias[None]
        self._bias = graph.constant(bias)
        self._begin()

    def _begin(self) -> None:
        """Set the first states: those of the step before, or at 0."""
        for layer in self._program.layers:
            for state in (["current"] if layer.current_decay.any() else []) + ["membrane"]:
                name, zero = f"{layer.name}.{state}", self._graph.constant(0.0)
                value = self._graph.state(name, layer.size) if self._kept else zero
                self._states[name] = (value, layer.size)
        for source, slots in self._plan.slots.items() if self._kept else ():
            for late in range(1, slots):
                name = _late(source, late)
                self._late[name] = self._graph.state(name, self._program.sizes[source])

    def run(self, spikes: list[Value], score: str) -> tuple[Value, States]:
        """Add all timesteps; return the score, and the states after the last that are kept."""
        outputs = []
        for t, arriving in enumerate(spikes):
            self._rows[self._program.input].append(arriving)
            for layer, lags in zip(self._program.layers, self._program.lags, strict=True):
                self._rows[layer.name].append(self._add_layer(layer, lags, t))
            outputs.append(self._add_output(t))
        total = outputs[0]
        for output in outputs[1:] if score != "last" else ():
            total = total + output
        found = outputs[-1] if score == "last" else total / float(len(spikes))
        return found, {**self._states, **self._under_way(len(spikes))} if self._kept else {}

    def _shared(self, array: NDArray[np.generic]) -> Value:
        """A constant of the program, which all timesteps read."""
        if id(array) not in self._constants:  # which is kept, so that no other gets its id
            self._constants[id(array)] = array, self._graph.constant(array.astype(np.float64))
        return self._constants[id(array)][1]

    def _row(self, source: str, t: int) -> Value | None:
        """The output of a source in a timestep; None before the first one."""
        return self._rows[source][t] if t >= 0 else self._late.get(_late(source, -t))

    def _under_way(self, timesteps: int) -> States:
        """Rows that arrive in the next control step."""
        found: States = {}
        for source, slots in self._plan.slots.items():
            for late in range(1, slots):
                if (row := self._row(source, timesteps - late)) is not None:
                    found[_late(source, late)] = (row, self._program.sizes[source])
        return found

    def _add_layer(self, layer: Layer, lags: tuple[int, ...], t: int) -> Value:
        """Add a timestep of a layer; return its spikes, or its membranes where it has none."""
        drive = self._shared(layer.bias)
        for synapses, lag in zip(layer.synapses, lags, strict=True):
            if (row := self._row(synapses.source, t - lag)) is not None:
                drive = drive + row @ self._shared(synapses.weight)
        if f"{layer.name}.current" in self._states:
            # I = a I + W s
            drive = self._left(layer, "current", layer.current_decay) + drive
            self._states[f"{layer.name}.current"] = (drive, layer.size)
        # V = b V + I + leak
        kept = self._left(layer, "membrane", layer.membrane_decay)
        membrane = kept + drive + self._shared(layer.voltage_bias)
        sent = membrane
        if layer.spiking:
            threshold = self._shared(layer.threshold)
            above = membrane > threshold
            subtracts = self._program.convention.reset == "subtract"
            after = membrane - threshold if subtracts else self._graph.constant(0.0)
            membrane = self._graph.node("Where", above, after, membrane)
            sent = self._graph.floats(above)
        self._states[f"{layer.name}.membrane"] = (membrane, layer.size)
        return sent

    def _left(self, layer: Layer, state: str, decay: NDArray[np.generic]) -> Value:
        return self._shared(decay) * self._states[f"{layer.name}.{state}"][0]

    def _add_output(self, t: int) -> Value:
        """Add what the host receives in a timestep (B, act)."""
        total = self._bias
        for term in self._program.output_terms:
            if (row := self._row(term.layer, t - term.lag)) is not None:
                total = total + (row if term.weight is None else row @ self._shared(term.weight))
        return total


def _late(source: str, late: int) -> str:
    """Name of the state that holds the spikes of a source so many timesteps ago."""
    return f"{source}.spikes-{late}"
