"""Encoders in ONNX: from a normalised observation to the spikes of every timestep.

They are the equations of runtime/codec, written out timestep by timestep.
"""

from typing import TypeAlias

import numpy as np

from spikedeploy.exporters.onnx_graph import OBSERVATION, OnnxGraph
from spikedeploy.runtime.codec.codec import Codec, Normaliser
from spikedeploy.runtime.codec.delta import LARGEST, PARTS, DeltaEncoder
from spikedeploy.runtime.codec.population import PopulationEncoder
from spikedeploy.runtime.codec.rate import LEVELS, RateEncoder
from spikedeploy.runtime.errors import ConfigError

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


def encoded(graph: OnnxGraph, codec: Codec) -> tuple[Spikes, dict[str, tuple[str, int]]]:
    """Spikes (B, M) of each timestep; and states: name -> value after the step, and its width."""
    x, encoder = _normalised(graph, codec.normaliser), codec.encoder
    if isinstance(encoder, DeltaEncoder):
        return _delta(graph, encoder, x, codec.timesteps)
    if isinstance(encoder, PopulationEncoder):
        return _population(graph, encoder, x, codec.timesteps), {}
    if isinstance(encoder, RateEncoder):
        return _rate(graph, encoder, x, codec.timesteps), {}
    raise TypeError(type(encoder).__name__)


def _normalised(graph: OnnxGraph, normaliser: Normaliser) -> str:
    mean, std = graph.constant("mean", normaliser.mean), graph.constant("std", normaliser.std)
    shifted = graph.node("Sub", [OBSERVATION, mean], "shifted")
    return _clipped(
        graph, graph.node("Div", [shifted, std], "scaled"), normaliser.clip, "normalised"
    )


def _clipped(graph: OnnxGraph, value: str, most: float, name: str) -> str:
    limits = [graph.constant(f"{name}.lowest", -most), graph.constant(f"{name}.highest", most)]
    return graph.node("Clip", [value, *limits], name)


def _delta(
    graph: OnnxGraph, encoder: DeltaEncoder, x: str, timesteps: int
) -> tuple[Spikes, dict[str, tuple[str, int]]]:
    """Events n where an observation has moved, and the levels q moved by them."""
    step, parts = graph.constant("step", encoder.step), graph.constant("parts", float(PARTS))
    moved = graph.node("Mul", [graph.node("Div", [x, step], "steps"), parts], "fine")
    rounded = graph.node("Round", [_clipped(graph, moved, float(LARGEST), "bounded")], "rounded")
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
