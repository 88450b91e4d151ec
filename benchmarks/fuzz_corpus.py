"""Valid networks that fuzzing starts from: all primitives, our metadata."""

from itertools import pairwise
from pathlib import Path

import nir
import numpy as np

from benchmarks.fuzz_records import write_records
from spikedeploy.runtime.artifact.artifact import Artifact, save
from spikedeploy.runtime.codec.codec import Codec, DeltaEncoder, Normaliser, PopulationEncoder
from spikedeploy.runtime.codec.rate import RateEncoder
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.metadata import Provenance

TWO = np.array([2, 2])
ORIGIN = Provenance(
    "spikedeploy/Hexapod-v0", "smoke", seed=3, steps=7, created="2026-01-01T00:00:00Z"
)


def write_corpus(folder: Path) -> list[Path]:
    """Write the files; those with our metadata are called ours-*."""
    folder.mkdir(parents=True, exist_ok=True)
    graphs = {
        "convolutional": convolutional(),
        "series": series(),
        "every-neuron": every_neuron(),
        "nested": nested(),
        "two-ways": two_ways(),
        "loop": loop(),
    }
    for name, graph in graphs.items():
        nir.write(folder / f"{name}.nir", graph)
    policies = {"population": population(), "rate": rate(), "delta": delta()}
    for name, artifact in policies.items():
        save(artifact, folder / f"ours-{name}.nir")
    write_records(folder)
    return sorted(path for path in folder.iterdir() if not path.name.startswith("."))


def lif(*shape: int, tau: float = 4e-3, gain: float = 4.0) -> nir.LIF:
    """Neurons with a gain of 1 at dt = 1 ms."""
    return nir.LIF(*(np.full(shape, v) for v in (tau, gain, 0.0, 1.0, 0.0)))


def cuba(*shape: int) -> nir.CubaLIF:
    """Neurons with gains of 1 at dt = 1 ms."""
    full = [np.full(shape, v) for v in (2e-3, 4e-3, 4.0, 0.0, 1.0, 0.0, 2.0)]
    return nir.CubaLIF(*full[:6], w_in=full[6])


def chain(takes: list[int], puts: list[int], **nodes: nir.NIRNode) -> nir.NIRGraph:
    """Input -> nodes -> output."""
    ends = {"input": nir.Input(np.array(takes)), "output": nir.Output(np.array(puts))}
    names = ["input", *nodes, "output"]
    return nir.NIRGraph({**ends, **nodes}, list(pairwise(names)), type_check=False)


def convolutional() -> nir.NIRGraph:
    """Both pools, a convolution in groups, one with a word for padding."""
    rng = np.random.default_rng(0)
    return chain(
        [2, 6, 6],
        [3],
        conv=nir.Conv2d((6, 6), rng.normal(size=(4, 1, 3, 3)), 1, "same", 1, 2, np.zeros(4)),
        cells=lif(4, 6, 6),
        sum=nir.SumPool2d(TWO, TWO, 0 * TWO),
        again=nir.Conv2d((3, 3), rng.normal(size=(2, 4, 2, 2)), TWO, TWO, TWO, 1, np.ones(2)),
        avg=nir.AvgPool2d(TWO, TWO, 0 * TWO),
        flat=nir.Flatten({"input": np.array([2, 1, 1])}, 0, -1),
        dense=nir.Affine(rng.normal(size=(3, 2)), np.ones(3)),
        last=cuba(3),
    )


def series() -> nir.NIRGraph:
    """A convolution over one axis, a scale, delays."""
    rng = np.random.default_rng(1)
    return chain(
        [2, 5],
        [6],
        conv=nir.Conv1d(5, rng.normal(size=(2, 2, 3)), 1, 0, 1, 1, np.zeros(2)),
        scale=nir.Scale(np.full((2, 3), 2.0)),
        delay=nir.Delay(1e-3 * np.arange(6.0).reshape(2, 3)),
        cells=nir.IF(*(np.full((2, 3), v) for v in (1000.0, 1.0, 0.0))),
        flat=nir.Flatten({"input": np.array([2, 3])}, 0, -1),
        weights=nir.Linear(rng.normal(size=(6, 6))),
        last=lif(6),
    )


def every_neuron() -> nir.NIRGraph:
    """Nodes that no chip supports."""
    full = {v: np.full(3, v) for v in (0.0, 0.5, 2e-3, 4e-3, 4.0, 2.0, 1000.0)}
    return chain(
        [3],
        [3],
        i=nir.I(full[1000.0]),
        li=nir.LI(full[4e-3], full[4.0], full[0.0]),
        cubali=nir.CubaLI(full[2e-3], full[4e-3], full[4.0], full[0.0], full[2.0]),
        threshold=nir.Threshold(full[0.5]),
        cells=lif(3),
    )


def nested() -> nir.NIRGraph:
    """Graphs nested three deep."""
    inner = chain([3], [3], cells=lif(3), weights=nir.Linear(np.eye(3)))
    middle = chain([3], [3], inner=inner, cells=cuba(3))
    return chain([3], [3], weights=nir.Affine(np.eye(3), np.zeros(3)), middle=middle)


def two_ways() -> nir.NIRGraph:
    """Two inputs, two outputs and a skip connection."""
    nodes = {
        "a": nir.Input(np.array([2])),
        "b": nir.Input(np.array([2])),
        "la": lif(2),
        "lb": cuba(2),
        "oa": nir.Output(np.array([2])),
        "ob": nir.Output(np.array([2])),
    }
    edges = [("a", "la"), ("b", "lb"), ("a", "lb"), ("la", "oa"), ("lb", "ob"), ("la", "ob")]
    return nir.NIRGraph(nodes, edges, type_check=False)


def loop() -> nir.NIRGraph:
    """A recurrent layer, and a delay behind it."""
    graph = chain([2], [2], cells=lif(2), more=lif(2))
    back = {"again": nir.Linear(np.eye(2)), "later": nir.Delay(np.full(2, 2e-3))}
    edges = [("cells", "again"), ("again", "cells"), ("more", "later"), ("later", "cells")]
    return nir.NIRGraph({**graph.nodes, **back}, [*graph.edges, *edges], type_check=False)


def population() -> Artifact:
    """A policy with a population code and provenance."""
    rng = np.random.default_rng(2)
    layers = {
        "in": nir.Affine(rng.normal(size=(5, 6)), np.zeros(5)),
        "cells": cuba(5),
        "readout": nir.Affine(rng.normal(size=(2, 5)), np.zeros(2)),
    }
    encoder = PopulationEncoder(np.tile([-1.0, 0.0, 1.0], (2, 1)), np.ones((2, 3)))
    codec = Codec(Normaliser(np.zeros(2), np.ones(2), 5.0), encoder, 5, "tanh")
    return Artifact(chain([6], [2], **layers), codec, Convention(1e-3), ORIGIN)


def rate() -> Artifact:
    """A policy with a rate code, without provenance, whose digest would show the change."""
    rng = np.random.default_rng(3)
    layers = {
        "in": nir.Affine(rng.normal(size=(5, 4)), np.zeros(5)),
        "cells": lif(5),
        "readout": nir.Affine(rng.normal(size=(3, 5)), np.zeros(3)),
    }
    code = RateEncoder(np.full(4, -1.0), np.ones(4))
    codec = Codec(Normaliser(np.zeros(4), np.ones(4), 1.0), code, 8, "argmax")
    return Artifact(chain([4], [3], **layers), codec, Convention(1e-3))


def delta() -> Artifact:
    """A policy with a delta code and states that are kept, without provenance."""
    rng = np.random.default_rng(4)
    code = DeltaEncoder(np.array([0.3, np.inf]), most=2)
    layers = {
        "in": nir.Affine(rng.normal(size=(5, code.width)), np.zeros(5)),
        "cells": cuba(5),
        "readout": nir.Affine(rng.normal(size=(3, 5)), np.zeros(3)),
    }
    codec = Codec(Normaliser(np.zeros(2), np.ones(2), 5.0), code, 1, "tanh")
    return Artifact(chain([code.width], [3], **layers), codec, Convention(1e-3, state="kept"))
