"""A spiking policy as one ONNX file: a control step (observation, states) -> (action, states).

    observation (B, obs) -> encoder -> layers, T timesteps written out -> mean, tanh -> action
    lif1.membrane (B, N)                ->                 next.lif1.membrane (B, N)

The inference is unrolled: its T timesteps follow one another in the graph, which has no loop. What
passes from one control step to the next comes in and goes out: levels of a delta code, and where
the convention keeps states also currents, membranes and spikes that are still under way. All begin
at 0. It is the program without rounding, chip `ideal`, in float64: it equals the float twin up to
the order in which float64 adds up.
"""

import hashlib
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import onnx
from numpy.typing import ArrayLike, NDArray
from onnx import helper, numpy_helper

from spikedeploy.exporters.c.plan import Plan
from spikedeploy.exporters.check import LargestDifference, ParityCheck
from spikedeploy.runtime.artifact.artifact import Artifact
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.chips.layer import Layer
from spikedeploy.runtime.codec.codec import GIVE_CODEC, Codec, Normaliser, Score
from spikedeploy.runtime.codec.delta import LARGEST, PARTS, DeltaEncoder
from spikedeploy.runtime.codec.population import PopulationEncoder
from spikedeploy.runtime.codec.rate import LEVELS, RateEncoder
from spikedeploy.runtime.compiler.compile import compile_program
from spikedeploy.runtime.emulator.network import FloatMachine
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.files import replacing
from spikedeploy.runtime.metadata import Provenance
from spikedeploy.trainers.onnx_session import NEXT, infer, rest, session

_OPSET = 17
_IR_VERSION = 8  # ONNX Runtime 1.17 and newer read both
OBSERVATION = "observation"
OUTPUTS = {"continuous": "action", "discrete": "logits"}  # by a policy's head


class OnnxGraph:
    """Nodes and constants from the observation to the output.

    kind: the type of all floats, float32 or float64.
    """

    def __init__(self, kind: type[np.floating[Any]] = np.float32) -> None:
        self._kind, self._element = kind, helper.np_dtype_to_tensor_dtype(np.dtype(kind))
        self._states: list[onnx.ValueInfoProto] = []
        self._next: list[onnx.ValueInfoProto] = []
        self._nodes: list[onnx.NodeProto] = []
        self._constants: list[onnx.TensorProto] = []
        self._presynaptic: list[onnx.ValueInfoProto] = []

    def constant(self, name: str, value: ArrayLike) -> str:
        """Add a constant, integers as int64 and anything else as floats; return its name."""
        array = np.asarray(value)
        exact = array.astype(np.int64 if array.dtype.kind == "i" else self._kind)
        self._constants.append(numpy_helper.from_array(exact, name))
        return name

    def node(self, operator: str, inputs: Sequence[str], output: str, **attributes: Any) -> str:  # noqa: ANN401
        """Add a node; return the name of its output."""
        self._nodes.append(helper.make_node(operator, inputs, [output], output, **attributes))
        return output

    def floats(self, flags: str, output: str) -> str:
        """Add 1.0 where a flag is true and 0.0 elsewhere; return its name."""
        return self.node("Cast", [flags], output, to=self._element)

    def presynaptic(self, name: str, width: int) -> None:
        """Make the input (B, width) of a weight matrix an output, to count effective operations."""
        self._presynaptic.append(self._rows(name, width))

    def state(self, name: str, width: int) -> str:
        """Add an input (B, width), what the step before left; return its name."""
        self._states.append(self._rows(name, width))
        return name

    def next_state(self, name: str, value: str, width: int) -> None:
        """Make a value the output of this name, which the next step takes for the state."""
        self.node("Identity", [value], name)
        self._next.append(self._rows(name, width))

    def _rows(self, name: str, width: int) -> onnx.ValueInfoProto:
        return helper.make_tensor_value_info(name, self._element, ["B", width])

    def sha256(self) -> str:
        """SHA-256 of the constants, in the order in which they were added."""
        sha = hashlib.sha256()
        for constant in self._constants:
            sha.update(f"{constant.name} {list(constant.dims)}".encode())
            sha.update(numpy_helper.to_array(constant).tobytes())
        return sha.hexdigest()

    def model(
        self, observations: int, actions: int, head: str, properties: dict[str, str]
    ) -> onnx.ModelProto:
        """Return the checked model, observation (B, obs) to the output (B, act) of a head.

        States come in after the observation, and go out last.
        """
        graph = helper.make_graph(
            self._nodes,
            "policy",
            [self._rows(OBSERVATION, observations), *self._states],
            [self._rows(OUTPUTS[head], actions), *self._presynaptic, *self._next],
            self._constants,
        )
        opsets = [helper.make_opsetid("", _OPSET)]
        model = helper.make_model(
            graph, opset_imports=opsets, ir_version=_IR_VERSION, producer_name="spikedeploy"
        )
        helper.set_model_props(model, properties)
        onnx.checker.check_model(model, full_check=True)
        return model


LEVELS_STATE = "codec:levels"  # events of each observation that were sent, with their signs

Spikes: TypeAlias = list[str]


def check_codec(codec: Codec) -> None:
    """Refuse codes that are not a function of the observation and of states."""
    encoder = codec.encoder
    if encoder.random:
        raise ConfigError(
            f"--to onnx: encoder {encoder.kind!r} draws random bytes by the generator of the chip, "
            "which ONNX has not. Train it with mode regular, or a population or delta code."
        )
    if not isinstance(encoder, DeltaEncoder | PopulationEncoder | RateEncoder):
        raise ConfigError(f"--to onnx: encoder {encoder.kind!r} is not written in ONNX.")


def add_encoder(graph: OnnxGraph, codec: Codec) -> tuple[Spikes, dict[str, tuple[str, int]]]:
    """Spikes (B, M) of each timestep; and states: name -> value after the step, and its width."""
    x, encoder = _add_normaliser(graph, codec.normaliser), codec.encoder
    if isinstance(encoder, DeltaEncoder):
        return _delta(graph, encoder, x, codec.timesteps)
    if isinstance(encoder, PopulationEncoder):
        return _population(graph, encoder, x, codec.timesteps), {}
    if isinstance(encoder, RateEncoder):
        return _rate(graph, encoder, x, codec.timesteps), {}
    raise TypeError(type(encoder).__name__)


def _add_normaliser(graph: OnnxGraph, normaliser: Normaliser) -> str:
    mean, std = graph.constant("mean", normaliser.mean), graph.constant("std", normaliser.std)
    shifted = graph.node("Sub", [OBSERVATION, mean], "shifted")
    return _add_clip(
        graph, graph.node("Div", [shifted, std], "scaled"), normaliser.clip, "normalised"
    )


def _add_clip(graph: OnnxGraph, value: str, most: float, name: str) -> str:
    limits = [graph.constant(f"{name}.lowest", -most), graph.constant(f"{name}.highest", most)]
    return graph.node("Clip", [value, *limits], name)


def _delta(
    graph: OnnxGraph, encoder: DeltaEncoder, x: str, timesteps: int
) -> tuple[Spikes, dict[str, tuple[str, int]]]:
    """Events n where an observation has moved, and the levels q moved by them."""
    step, parts = graph.constant("step", encoder.step), graph.constant("parts", float(PARTS))
    moved = graph.node("Mul", [graph.node("Div", [x, step], "steps"), parts], "fine")
    rounded = graph.node("Round", [_add_clip(graph, moved, float(LARGEST), "bounded")], "rounded")
    for name, value in (
        ("half", PARTS / 2),
        ("most", encoder.most),
        ("least", encoder.threshold),
        ("nothing", 0),
    ):
        graph.constant(name, float(value))
    graph.constant("signs", np.array([[1.0], [-1.0]]))
    graph.constant("channels", np.arange(1.0, encoder.most + 1))
    graph.constant("by_observation", [-1, encoder.observed, 1, 1])
    graph.constant("side_by_side", [-1, encoder.width])
    levels, spikes = graph.state(LEVELS_STATE, encoder.observed), []
    for t in range(timesteps):
        events = _events(graph, rounded, levels, f"codec:{t}")
        levels = graph.node("Add", [levels, events], f"codec:{t}.levels")
        spikes.append(_channels(graph, encoder, events, f"codec:{t}"))
    return spikes, {LEVELS_STATE: (levels, encoder.observed)}


def _events(graph: OnnxGraph, rounded: str, levels: str, at: str) -> str:
    """Signed numbers of events (B, obs) of a timestep."""
    # e = X - 256 q      n = sign(e) min((|e| + 128) >> 8, most)    where |e| > threshold
    sent = graph.node("Mul", [levels, "parts"], f"{at}.sent")
    apart = graph.node("Sub", [rounded, sent], f"{at}.apart")
    far = graph.node("Abs", [apart], f"{at}.far")
    near = graph.node("Add", [far, "half"], f"{at}.near")
    whole = graph.node("Floor", [graph.node("Div", [near, "parts"], f"{at}.share")], f"{at}.whole")
    number = graph.node("Min", [whole, "most"], f"{at}.number")
    signed = graph.node("Mul", [graph.node("Sign", [apart], f"{at}.sign"), number], f"{at}.signed")
    enough = graph.node("Greater", [far, "least"], f"{at}.enough")
    return graph.node("Where", [enough, signed, "nothing"], f"{at}.events")


def _channels(graph: OnnxGraph, encoder: DeltaEncoder, events: str, at: str) -> str:
    """Spikes (B, 2 K obs) of the channels of both signs."""
    apart = graph.node("Reshape", [events, "by_observation"], f"{at}.each")
    signed = graph.node("Mul", [apart, "signs"], f"{at}.of_sign")
    kind = "GreaterOrEqual" if encoder.code == "unary" else "Equal"
    spiking = graph.node(kind, [signed, "channels"], f"{at}.spiking")
    flat = graph.node("Reshape", [spiking, "side_by_side"], f"{at}.flat")
    return graph.floats(flat, f"{at}.spikes")


def _population(graph: OnnxGraph, encoder: PopulationEncoder, x: str, timesteps: int) -> Spikes:
    """Spikes of neurons that integrate the drive of their receptive fields."""
    drive = _drive(graph, encoder, x)
    threshold, membrane = graph.constant("codec:threshold", encoder.threshold), drive
    spikes: Spikes = []
    for t in range(timesteps):
        at = f"codec:{t}"
        if t:
            # v = (v - threshold * s) + A
            lost = graph.node("Mul", [threshold, spikes[-1]], f"{at}.lost")
            left = graph.node("Sub", [membrane, lost], f"{at}.left")
            membrane = graph.node("Add", [left, drive], f"{at}.membrane")
        above = graph.node("Greater", [membrane, threshold], f"{at}.above")
        spikes.append(graph.floats(above, f"{at}.spikes"))
    return spikes


def _drive(graph: OnnxGraph, encoder: PopulationEncoder, x: str) -> str:
    """Drive (B, M)."""
    # A = exp(-1/2 ((x - mean) / std)^2)
    shape = graph.constant("by_observation", [-1, encoder.observed, 1])
    centre, width = (
        graph.constant(f"codec:{n}", v) for n, v in (("mean", encoder.mean), ("std", encoder.std))
    )
    apart = graph.node("Sub", [graph.node("Reshape", [x, shape], "each"), centre], "apart")
    fields = graph.node("Div", [apart, width], "fields")
    squares = graph.node("Mul", [fields, fields], "squares")
    halves = graph.node("Mul", [squares, graph.constant("minus_half", -0.5)], "halves")
    flat = graph.constant("side_by_side", [-1, encoder.width])
    return graph.node("Reshape", [graph.node("Exp", [halves], "drives"), flat], "drive")


def _rate(graph: OnnxGraph, encoder: RateEncoder, x: str, timesteps: int) -> Spikes:
    """Carries of an accumulator to which the rate is added in each timestep."""
    low, span = (
        graph.constant("low", encoder.low),
        graph.constant("span", encoder.high - encoder.low),
    )
    limits = [graph.constant("nothing", 0.0), graph.constant("all", 1.0)]
    share = graph.node("Div", [graph.node("Sub", [x, low], "above_low"), span], "share")
    level = graph.constant("levels", float(LEVELS))
    fine = graph.node("Mul", [graph.node("Clip", [share, *limits], "part"), level], "fine")
    rate = graph.node("Round", [fine], "rate")
    half = graph.constant("half", LEVELS / 2)
    # c[t] = floor((n t + 128) / 256) ; s[t] = c[t + 1] - c[t]
    carried = []
    for t in range(timesteps + 1):
        at, times = f"codec:{t}", graph.constant(f"codec:{t}.times", float(t))
        total = graph.node(
            "Add", [graph.node("Mul", [rate, times], f"{at}.sum"), half], f"{at}.all"
        )
        carried.append(
            graph.node("Floor", [graph.node("Div", [total, level], f"{at}.part")], f"{at}.carried")
        )
    return [
        graph.node("Sub", [carried[t + 1], carried[t]], f"codec:{t}.spikes")
        for t in range(timesteps)
    ]


KIND = "snn-step"
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
    output, states, apart = network.get_outputs()[0].name, rest(network), LargestDifference()
    for row in observations[:, None]:
        scores = codec.scores(twin.infer(codec.encode(row, levels)))
        expected = np.tanh(scores) if codec.squash == "tanh" else scores
        (found,) = infer(network, [output], row, states)
        unit = max(1.0, float(np.abs(expected).max()))
        apart.add(found / unit, expected / unit)
    detail = f"largest difference {apart.largest:.1e}, limit {_TOLERANCE:.0e}"
    name = "scores" if codec.chooses else "actions"
    said = f"{len(observations):,} successive observations, {detail}"
    return [ParityCheck(f"{name}: float twin = ONNX Runtime", apart.within(_TOLERANCE), said)]


def _codec(artifact: Artifact) -> Codec:
    if artifact.codec is None:
        raise ConfigError(
            "--to onnx: the file has no codec (observation to spikes), so it cannot act. "
            f"{GIVE_CODEC}."
        )
    check_codec(artifact.codec)
    return artifact.codec


def _model(artifact: Artifact, name: str) -> onnx.ModelProto:
    codec, graph = _codec(artifact), OnnxGraph(np.float64)
    plan = Plan(compile_program(artifact, chip("ideal"), limits=False).dense("ONNX"), codec)
    if plan.program.graded:
        raise ConfigError(
            f"--to onnx: layer {min(plan.program.graded)!r}: sigma-delta neurons are not written "
            "in ONNX. Train neurons that spike."
        )
    spikes, states = add_encoder(graph, codec)
    states |= _Network(graph, plan).run(spikes, codec.score)
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
    """Metadata: the origin of the policy, as in the files of float policies."""
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

    def run(self, spikes: list[str], score: Score) -> dict[str, tuple[str, int]]:
        """Add all timesteps, up to "score"; return the states after the last that are kept."""
        total = ""
        for t, arriving in enumerate(spikes):
            self._rows[self._plan.program.input].append(arriving)
            for layer, lags in zip(self._plan.program.layers, self._plan.program.lags, strict=True):
                self._rows[layer.name].append(self._add_layer(layer, lags, t))
            output = self._add_output(t)
            total = self._graph.node("Add", [total, output], f"host:{t}.total") if t else output
        if score == "last":
            self._graph.node("Identity", [output], "score")
        else:
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
        if program.host_outputs:
            return self._graph.constant("host:bias", program.host_outputs[0].bias[None])
        bias = 0.0 if program.readout is None else program.readout.bias[None]
        return self._graph.constant("host:bias", bias)

    def _begin(self) -> None:
        """Set the first states: those of the step before, or at 0."""
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
        """Name of the output of a source in a timestep; "" before the first one."""
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

    def _add_layer(self, layer: Layer, lags: tuple[int, ...], t: int) -> str:
        """Add a timestep of a layer; return its spikes, or its membranes where it has none."""
        node, at = self._graph.node, f"{layer.name}.{t}"
        drive = self._add_synapses(layer, lags, t)
        if f"{layer.name}.current" in self._states:
            # I = a I + W s
            kept = self._add_decay(layer.name, "current", at)
            drive = node("Add", [kept, drive], f"{at}.current")
            self._states[f"{layer.name}.current"] = (drive, layer.size)
        # V = b V + I + leak
        kept = self._add_decay(layer.name, "membrane", at)
        driven = node("Add", [kept, drive], f"{at}.driven")
        membrane = node("Add", [driven, f"{layer.name}.leak"], f"{at}.membrane")
        if not layer.spiking:
            self._states[f"{layer.name}.membrane"] = (membrane, layer.size)
            return membrane
        return self._add_spikes(layer, membrane, at)

    def _add_spikes(self, layer: Layer, membrane: str, at: str) -> str:
        """Add the spikes of a timestep and the resets."""
        node, threshold = self._graph.node, f"{layer.name}.threshold"
        above = node("Greater", [membrane, threshold], f"{at}.above")
        after = "zero"
        if self._plan.program.convention.reset == "subtract":
            after = node("Sub", [membrane, threshold], f"{at}.less")
        left = node("Where", [above, after, membrane], f"{at}.left")
        self._states[f"{layer.name}.membrane"] = (left, layer.size)
        return self._graph.floats(above, f"{at}.spikes")

    def _add_decay(self, name: str, state: str, at: str) -> str:
        before, _ = self._states[f"{name}.{state}"]
        return self._graph.node("Mul", [f"{name}.{state}_decay", before], f"{at}.{state}_left")

    def _add_synapses(self, layer: Layer, lags: tuple[int, ...], t: int) -> str:
        total = f"{layer.name}.bias"
        for k, (synapses, lag) in enumerate(zip(layer.synapses, lags, strict=True)):
            if row := self._row(synapses.source, t - lag):
                at = f"{layer.name}.{t}.{k}"
                sums = self._graph.node("MatMul", [row, f"{layer.name}.weight{k}"], f"{at}.sums")
                total = self._graph.node("Add", [total, sums], f"{at}.arriving")
        return total

    def _add_output(self, t: int) -> str:
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
