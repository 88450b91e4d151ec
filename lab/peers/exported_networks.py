"""Networks of other tools, exported by the tools themselves, with spikes that the tools computed.

    python -m lab exported-networks TOOL [FOLDER]

writes a .nir for each network of a tool that is installed (snntorch, norse, spikingjelly), and a
.npz (input, output) for each case of it: what a file does not say, such as the reset, makes several
of one. FOLDER is tests/golden/exports. tests/runtime/dialects/test_tools.py reads what is
committed there, tests/runtime/test_peer_exports.py records it anew where a tool is installed.
"""

import argparse
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import nir
import numpy as np

# neurons that reset as chips do; docs/snntorch-to-chips.md says when they are needed
_AT_ONCE = """\
class AtOnce:
    def mem_reset(self, mem):
        return torch.zeros_like(mem)  # nothing is left to reset of the timestep before

    def forward(self, x):
        spikes = super().forward(x)
        self.mem = self.mem - spikes * self.threshold  # to zero: self.mem * (1 - spikes)
        return spikes


class Leaky(AtOnce, snntorch.Leaky):  # likewise Synaptic, RLeaky and RSynaptic
    pass


layer = Leaky(torch.full((16,), 0.9), torch.ones(16), init_hidden=True)
"""
FOLDER = Path(__file__).parents[2] / "tests" / "golden" / "exports"
# neurons of each layer, and timesteps
SIZES, TIMESTEPS = (12, 16, 6), 200


@dataclass(frozen=True)
class Exported:
    """A network in its tool.

    tool: as --from names it.
    file: name of its .nir file.
    build: to the torch module and its graph, exported by the tool.
    options: what the file does not say, as `load` takes it; written_by is the tool if it is not in.
    """

    tool: str
    file: str
    build: Callable[[], tuple[Any, nir.NIRGraph]]
    options: dict[str, Any]


def raster() -> np.ndarray:
    """Input spikes (T, M), the same for all."""
    rng = np.random.default_rng(7)
    return (rng.random((TIMESTEPS, SIZES[0])) < 0.3).astype(np.uint8)


def chain(neurons: Callable[[int], Any], gain: float, linear: Any = None, join: Any = None) -> Any:  # noqa: ANN401
    """Two layers with seeded weights and biases, large enough that both spike.

    linear, join  of the tool, where it has its own
    """
    import torch

    linear, join = linear or torch.nn.Linear, join or torch.nn.Sequential
    one, two, three = SIZES
    module = join(linear(one, two), neurons(two), linear(two, three), neurons(three))
    rng = np.random.default_rng(3)
    for each in (each for each in module.modules() if isinstance(each, torch.nn.Linear)):
        size, fan_in = each.weight.shape
        drawn = gain * 1.5 * rng.normal(size=(size, fan_in)) / fan_in**0.5
        each.weight.data = torch.tensor(drawn, dtype=torch.float32)
        each.bias.data = torch.tensor(gain * 0.1 * rng.random(size), dtype=torch.float32)
    return module


def snntorch_network(
    kind: str,
    at_once: bool = False,
    **options: Any,  # noqa: ANN401
) -> tuple[Any, nir.NIRGraph]:
    """Two layers of Leaky, Synaptic, RLeaky or RSynaptic, or Leaky and Synaptic of odd decays.

    Parameters are vectors, which its export needs.

    at_once  that reset as chips do, by the lines above
    """
    import snntorch
    import torch
    from snntorch.export_nir import export_to_nir

    neuron = getattr(snntorch, kind.removeprefix("Odd"))
    if at_once:
        names: dict[str, Any] = {"torch": torch, "snntorch": snntorch}
        exec(_AT_ONCE, names)
        neuron = type(kind, (names["AtOnce"], neuron), {})

    def neurons(size: int) -> Any:  # noqa: ANN401
        given = {"beta": torch.linspace(0.8, 0.95, size), "threshold": torch.ones(size)}
        if kind.startswith("Odd"):
            # it clamps decay factors between 0 and 1
            given["beta"] = torch.tensor([0.0, 1.0, 1.2, -0.3, 0.5, 1e-3] * size)[:size]
        if kind.endswith("Synaptic"):
            given["alpha"] = torch.full((size,), 0.6)
        if kind == "OddSynaptic":
            given["alpha"] = torch.tensor([0.0, 0.1, -0.3, 0.0, 1e-3] * size)[:size]
        if kind.startswith("R"):
            given["linear_features"] = size
        return neuron(**given, init_hidden=True, **options)

    module = chain(neurons, 0.4 if kind in ("Synaptic", "RSynaptic") else 1.0)
    recurrent = [layer.recurrent for layer in module[1::2] if kind.startswith("R")]
    rng = np.random.default_rng(5)
    for each in recurrent:
        size = len(each.weight)
        each.weight.data = torch.tensor(rng.normal(size=(size, size)), dtype=torch.float32) / 4
        each.bias.data = torch.zeros(size)
    graph = export_to_nir(module, torch.zeros(1, SIZES[0]), ignore_dims=[0])
    for layer in module[1::2]:
        layer.reset_mem()
    return module, graph


def norse_network(
    kind: str, subtract: bool = False, v_leak: float = 0.0
) -> tuple[Any, nir.NIRGraph]:
    """Two layers of LIFBoxCell, LIFCell or IAFCell; parameters as vectors, which NIR needs."""
    import norse.torch as norse
    import torch
    from norse.torch.functional.reset import reset_subtract, reset_value

    def neurons(size: int) -> Any:  # noqa: ANN401
        full = {"v_th": torch.ones(size)}
        if kind == "IAFCell":
            return norse.IAFCell(norse.IAFParameters(**full))
        full |= {
            "tau_mem_inv": torch.linspace(80, 200, size),
            "v_leak": torch.full((size,), v_leak),
        }
        if kind == "LIFCell":
            full["tau_syn_inv"] = torch.full((size,), 300.0)
            return norse.LIFCell(norse.LIFParameters(**full))
        method = reset_subtract if subtract else reset_value
        return norse.LIFBoxCell(norse.LIFBoxParameters(**full, reset_method=method))

    gain = {"LIFBoxCell": 5.0, "LIFCell": 1.5, "IAFCell": 1.0}[kind]
    module = chain(neurons, gain, join=norse.SequentialState)
    return module, norse.to_nir(module, torch.zeros(SIZES[0]))


def spikingjelly_network(kind: str, **options: Any) -> tuple[Any, nir.NIRGraph]:  # noqa: ANN401
    """Two layers of LIFNode, IFNode or CUBALIFNode."""
    import torch
    from spikingjelly.activation_based import functional, layer, neuron
    from spikingjelly.activation_based.nir_exchange import export_to_nir

    gain = 3.0 if options.get("decay_input", kind == "LIFNode") else 1.0
    module = chain(lambda _: getattr(neuron, kind)(**options), gain, layer.Linear)
    graph = export_to_nir(module, torch.zeros(1, SIZES[0]))
    functional.reset_net(module)
    return module, graph


def _cases() -> Iterator[tuple[str, Exported]]:
    resets = {
        "default": ({}, {}),
        "zero": ({"reset_mechanism": "zero", "reset_delay": False}, {"reset": "zero"}),
        "subtract": ({"reset_delay": False}, {"reset": "subtract"}),
        "zero_delayed": ({"reset_mechanism": "zero"}, {"reset": "zero-delayed"}),
        "none": ({"reset_mechanism": "none"}, {"reset": "none"}),
        "at_once": ({"at_once": True}, {"written_by": None, "dt": 1e-4, "reset": "subtract"}),
    }
    # RSynaptic has no reset_delay=False: with init_hidden it crashes, and else it resets late
    late = {name: each for name, each in resets.items() if name not in ("zero", "subtract")}
    odd = {name: resets[name] for name in ("default", "zero")}
    kinds = {"Leaky": resets, "Synaptic": resets, "RLeaky": resets, "RSynaptic": late}
    for kind, cases in (kinds | {"OddLeaky": odd, "OddSynaptic": odd}).items():
        file = f"snntorch_{kind.lower()}"
        for name, (options, given) in cases.items():
            build = partial(snntorch_network, kind, **options)
            yield f"{file}_{name}", Exported("snntorch", file, build, given)
    for kind in ("LIFBoxCell", "LIFCell", "IAFCell"):
        file = f"norse_{kind.lower()}"
        yield file, Exported("norse", file, partial(norse_network, kind), {})
    file, build = "norse_lifboxcell", partial(norse_network, "LIFBoxCell", subtract=True)
    yield f"{file}_subtract", Exported("norse", file, build, {"reset": "subtract"})
    # membranes start where they leak to
    for kind in ("LIFBoxCell", "LIFCell"):
        file, build = f"norse_{kind.lower()}_leak", partial(norse_network, kind, v_leak=0.4)
        yield file, Exported("norse", file, build, {})
    jelly: dict[str, tuple[str, dict[str, Any]]] = {
        "lif": ("LIFNode", {}),
        "lif_slow": ("LIFNode", {"tau": 5.0, "decay_input": False, "v_reset": -0.25}),
        "if": ("IFNode", {}),
        "if_reset": ("IFNode", {"v_reset": -0.5}),
        "cuba": ("CUBALIFNode", {"c_decay": 0.0, "v_decay": 0.8, "v_reset": -0.5}),
    }
    for name, (kind, options) in jelly.items():
        file, build = f"spikingjelly_{name}", partial(spikingjelly_network, kind, **options)
        yield file, Exported("spikingjelly", file, build, {})


CASES = dict(_cases())


def record(name: str, folder: Path) -> tuple[Path, Path]:
    """Write the graph and the trace of a case; return their paths."""
    import torch

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        module, graph = CASES[name].build()
        spikes = np.array([row.numpy() for row in _played(module, torch)])
    folder.mkdir(parents=True, exist_ok=True)
    network, trace = folder / f"{CASES[name].file}.nir", folder / f"{name}.npz"
    nir.write(network, graph)
    np.savez_compressed(trace, input=raster(), output=spikes.astype(np.uint8))
    return network, trace


def _played(module: Any, torch: Any) -> Iterator[Any]:  # noqa: ANN401
    """Output spikes (N,) of each timestep."""
    stateful, state = type(module).__name__ == "SequentialState", None
    with torch.no_grad():
        for row in torch.from_numpy(raster().astype(np.float32)):
            if stateful:
                spikes, state = module(row[None], state)
            else:
                spikes = module(row[None])
            yield spikes[0]


def main() -> None:
    """Record the networks of a tool."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("tool", choices=sorted({each.tool for each in CASES.values()}))
    parser.add_argument("folder", nargs="?", type=Path, default=FOLDER)
    arguments = parser.parse_args()
    for case in (name for name, each in CASES.items() if each.tool == arguments.tool):
        written = record(case, arguments.folder)[1]
        print(f"{case}: {np.load(written)['output'].sum()} spikes")
