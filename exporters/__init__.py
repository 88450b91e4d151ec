"""Exporters: a trained policy in, one portable file out, and the proof that both do the same.

Each exporter is a function `(policy, origin, path, ...) -> Path`, named in the table below. A new
format is one new file and one new line here.

to_nir       a spiking policy as `.nir`
to_onnx      a float policy as `.onnx`; a spiking one by spiking_onnx
spiking_onnx a spiking policy as one step in ONNX, states in and out
parity       a written file against its policy: NIR spike by spike, ONNX action by action
check        one line of a parity report, and its counters
to_program   a compiled program as plain files, and what is expected of a chip; takes no torch
kit/         beside it: scripts for the chips' tools, copied as they are, and imported by nothing
to_xylo      a compiled program as a specification for Rockpool, beside the table
c/           a compiled program as C99 for microcontrollers, beside the table: it takes no torch
verilog/     a compiled program as Verilog for FPGAs, beside the table likewise
"""

from collections.abc import Callable
from difflib import get_close_matches
from importlib import import_module
from pathlib import Path

from spikedeploy.runtime.errors import ConfigError

EXPORTERS = {
    "nir": "spikedeploy.exporters.to_nir:to_nir",
    "onnx": "spikedeploy.exporters.to_onnx:to_onnx",
}


def exporter(name: str) -> Callable[..., Path]:
    """The exporter called `name`, imported now."""
    if name not in EXPORTERS:
        near = get_close_matches(name, EXPORTERS, n=1, cutoff=0.3)
        hint = f"; did you mean {near[0]!r}" if near else ""
        raise ConfigError(f"no exporter {name!r}{hint}; known: {', '.join(EXPORTERS)}")
    module, function = EXPORTERS[name].split(":")
    loaded: Callable[..., Path] = getattr(import_module(module), function)
    return loaded
