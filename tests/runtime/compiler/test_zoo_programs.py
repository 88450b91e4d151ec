"""Shipped policies compile to the integers that they always compiled to."""

import hashlib

import numpy as np
import pytest

from spikedeploy import zoo
from spikedeploy.runtime.artifact.artifact import load
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.compiler.compile import compile_program

# digests of programs, computed before there were readout layers, and delays on loihi1-nengo
DIGESTS = {
    ("hexapod/popsan", "loihi1"): "524fcd64050600d6",
    ("hexapod/popsan", "loihi1-nengo:delay=0"): "d7b846ac45cef13c",
    ("hexapod/popsan", "spinnaker2"): "df1f832afd0a68c6",
    ("hexapod/popsan", "int"): "1e504c46f9fc1da0",
    ("hexapod-command/popsan", "loihi1"): "b863bf24f5f68e9e",
    ("hexapod-command/popsan", "loihi1-nengo:delay=0"): "75136c5148b36833",
    ("hexapod-command/popsan", "spinnaker2"): "d655e533b08c8b66",
    ("hexapod-command/popsan", "int"): "afb29509f9fe8440",
    ("kart-gazebo/snn", "loihi1"): "ecc2d914209a6f95",
    ("kart-gazebo/snn", "loihi1-nengo:delay=0"): "bbc082b59f7f83a3",
    ("kart-gazebo/snn", "spinnaker2"): "620a8cf9ce880819",
    ("kart-gazebo/snn", "int"): "a7efd2f07b032970",
    ("kart-grid/snn", "loihi1"): "0a82d60283a8d440",
    ("kart-grid/snn", "loihi1-nengo:delay=0"): "18e70bff279da106",
    ("kart-grid/snn", "spinnaker2"): "f082c83885eda45f",
    ("kart-grid/snn", "int"): "c8132a69dfea0517",
    ("kart-steer/snn", "loihi1"): "d10253f7233fcbae",
    ("kart-steer/snn", "loihi1-nengo:delay=0"): "79b85a6e2b796dd4",
    ("kart-steer/snn", "spinnaker2"): "63255cf5eb4daca2",
    ("kart-steer/snn", "int"): "b3c817f119ba1d05",
}
# of the files that they were computed from; another file is another network
FILES = {
    "hexapod/popsan": "3a0e6e85a6c4495c",
    "hexapod-command/popsan": "2c0a6887a208e993",
    "kart-gazebo/snn": "6177c46d4946cecb",
    "kart-grid/snn": "d8b54c42f9e90043",
    "kart-steer/snn": "61a02e13124803e3",
}


def digest(program):
    """Of every number of every layer, with its type."""
    found = hashlib.sha256()
    for layer in program.layers:
        found.update(f"{layer.name} {layer.start} {layer.aliases}".encode())
        for s in layer.synapses:
            about = f"{s.source} {s.delay} {s.shift} {s.current} {s.weight.dtype}"
            found.update(about.encode() + np.ascontiguousarray(s.weight).tobytes())
        numbers = (layer.bias, layer.voltage_bias, layer.threshold, layer.current_decay)
        for values in (*numbers, layer.membrane_decay, np.asarray(layer.scale)):
            found.update(str(values.dtype).encode() + np.ascontiguousarray(values).tobytes())
    return found.hexdigest()[:16]


@pytest.mark.parametrize(("policy", "name"), DIGESTS)
def test_a_shipped_policy_compiles_to_the_same_numbers_as_before(policy, name):
    file = zoo.path(policy)
    if file is None or hashlib.sha256(file.read_bytes()).hexdigest()[:16] != FILES[policy]:
        pytest.skip("the file is another one")
    program = compile_program(load(file), chip(name), limits=False)
    assert digest(program) == DIGESTS[policy, name]
