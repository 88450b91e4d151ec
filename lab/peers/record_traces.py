"""Record golden traces again with the tools that they come from, and compare every number.

    python -m lab record-traces [FILE.json …] [--tool xylosim] [--out FOLDER]
    python -m lab record-traces --random 10 --tool lava --out FOLDER

A trace holds its network and its input: both are given to the tool, and what it records must be
what the file holds. `--out` writes the traces as they are recorded now. `--random` makes networks
of several layers and records them, for `spikedeploy verify`. A tool
that cannot be imported is named, and its traces are left out. spikedeploy is not needed, so that
this runs in environments whose NumPy is older than ours allows. Exits with 1 where a number
differs, and with 77 where nothing could be recorded.
"""

import argparse
import json
from collections.abc import Callable, Iterator
from functools import cache
from importlib import import_module
from importlib.metadata import version
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

GOLDEN = Path(__file__).parents[2] / "tests" / "golden"
# module of lab.peers.traces, and what the `source` of its traces begins with
TOOLS = {
    "brian2_loihi": "brian2-loihi",
    "lava": "lava",
    "nengo_loihi": "nengo-loihi",
    "sanafe": "sanafe",
    "xylosim": "xylosim",
}
NOTHING_RECORDED = 77
Trace = dict[str, Any]

# neurons of the input and of each layer
SIZES = (10, 12, 8, 3)
# share of inputs with an event in a control step
EVENTS = 0.25
# a threshold mantissa that no membrane reaches
OUT_OF_REACH = (1 << 17) - 1
# chip's largest membrane; nengo-loihi is given it
LARGEST = (1 << 23) - 1
# module of lab.peers.traces -> what a trace says of who recorded it
SOURCES = {
    "lava": "lava-nc, Loihi1SimCfg fixed_pt",
    "nengo_loihi": "nengo-loihi, EmulatorInterface in integers",
    "brian2_loihi": "brian2-loihi, LoihiNetwork",
}

# timesteps from an event to the readout: inputs act in the next one, or in the same
DEPTH = {"lava": 3, "nengo_loihi": 3, "brian2_loihi": 2}
# tools whose synapses have delays, and the longest that is tried [timesteps]
DELAYED = {"lava": 9, "brian2_loihi": 9}


def golden_traces() -> list[Path]:
    """The traces whose tool is here: not those of RTL, Speck or a board, which others recorded.

    What our own commands put out (commands/) is no trace.
    """
    elsewhere = ("rtl", "speck", "board", "commands")
    return sorted(path for path in GOLDEN.rglob("*.json") if path.parent.name not in elsewhere)


def main() -> int:
    """Record every trace whose tool is there; return the exit code."""
    arguments = parse_options()
    if arguments.random:
        return record_random(arguments.tool, arguments.random, arguments.out)
    same = different = 0
    for path in arguments.files or golden_traces():
        trace = json.loads(path.read_text("utf-8"))
        name = tool(trace)
        if arguments.tool not in (None, name):
            continue
        record = recorder(name)
        if isinstance(record, str):
            print(f"- {path.name}: {record}")
            continue
        found = record(trace)
        first = next(differences(trace, found), None)
        print(f"✗ {path.name}: {first}" if first else f"✓ {path.name}: {count(found)} numbers")
        same, different = same + (first is None), different + (first is not None)
        if arguments.out:
            write(arguments.out / path.name, name, merge(trace, found))
    print(f"{same} recorded again and equal, {different} different")
    return 1 if different else 0 if same else NOTHING_RECORDED


def record_random(name: str, networks: int, folder: Path) -> int:
    """Record random networks in each clock, with delays of synapses too where the tool has them."""
    record = recorder(name)
    if isinstance(record, str):
        print(f"- {record}")
        return NOTHING_RECORDED
    for seed in range(networks):
        for kind, options in random_kinds(name).items():
            trace = random_trace(name, seed, **options)
            write(folder / f"{name}_{kind}_{seed}.json", name, merge(trace, record(trace)))
    print(f"{networks * len(random_kinds(name))} random networks recorded")
    return 0


def tool(trace: Trace) -> str:
    """Name of the module that records the trace."""
    source = trace["source"].lower().replace("sana-fe", "sanafe")
    for name, start in TOOLS.items():
        if source.startswith(start):
            return name
    raise ValueError(f"no tool records traces of {trace['source']!r}; there are {', '.join(TOOLS)}")


@cache
def recorder(name: str) -> Callable[[Trace], Trace] | str:
    """The tool's `record`, or why there is none."""
    try:
        found: Callable[[Trace], Trace] = import_module(f"lab.peers.traces.{name}").record
    except Exception as error:  # whatever a tool of others raises when it is imported
        return f"{name} cannot be imported: {type(error).__name__}: {error}"
    return found


def merge(trace: Any, recorded: Any) -> Any:  # noqa: ANN401
    """The trace with another recording; lists of layers are merged layer by layer."""
    if isinstance(recorded, dict):
        new = {k: merge(trace[k], v) if k in trace else v for k, v in recorded.items()}
        return {**trace, **new}
    if isinstance(recorded, list) and recorded and isinstance(recorded[0], dict):
        return [merge(*pair) for pair in zip(trace, recorded, strict=True)]
    return recorded


def differences(old: Any, new: Any, where: str = "") -> Iterator[str]:  # noqa: ANN401
    """Where a recording is another than the file's, number by number."""
    if isinstance(new, dict):
        for key, value in new.items():
            if key not in old:
                yield f"{where}{key} is not in the file"
            else:
                yield from differences(old[key], value, f"{where}{key} ")
    elif isinstance(new, list) and isinstance(old, list) and len(old) == len(new):
        for k, (was, found) in enumerate(zip(old, new, strict=True)):
            yield from differences(was, found, f"{where}{k} ")
    elif old != new:
        yield f"{where}was {str(old)[:60]}, is {str(new)[:60]}"


def count(recorded: Any) -> int:  # noqa: ANN401
    """Numbers in a recording."""
    if isinstance(recorded, dict):
        return sum(map(count, recorded.values()))
    return sum(map(count, recorded)) if isinstance(recorded, list) else 1


def write(path: Path, name: str, trace: Trace) -> None:
    """A trace that names the versions that recorded it."""
    packages = import_module(f"lab.peers.traces.{name}").PACKAGES
    source = ", ".join(f"{package} {version(package)}" for package in packages)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps({**trace, "source": source}), "utf-8")


def parse_options() -> argparse.Namespace:
    """Return the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("files", nargs="*", type=Path, help="default: all of tests/golden")
    parser.add_argument("--tool", choices=TOOLS, help="only the traces of this tool")
    parser.add_argument("--out", type=Path, help="folder for the traces as recorded now")
    parser.add_argument("--random", type=int, metavar="N", help="record N random networks a clock")
    arguments = parser.parse_args()
    if arguments.random and (arguments.tool not in SOURCES or not arguments.out):
        parser.error(f"--random needs --out, and --tool of {', '.join(SOURCES)}")
    return arguments


# Random networks and their input, as traces that a tool has yet to record. Inputs reach the first
# layer and, unless it is a chain, past it the others; the last layer is a readout, whose threshold
# is out of reach and whose membranes are probed. Nothing is reset between control steps. A control
# step is one timestep (clock pipelined), or several with events in the first alone (clock free).


def random_kinds(tool: str) -> dict[str, dict[str, Any]]:
    """Name -> options of `random_trace`: each clock, and delays where the tool has them.

    A chain that runs free has as many timesteps as its events need to reach the readout.
    """
    kinds: dict[str, dict[str, Any]] = {
        "clock_pipelined": {},
        "clock_free": {"control_steps": 40, "timesteps": 3},
        "chain_free": {"control_steps": 40, "timesteps": DEPTH[tool] + 1, "skips": False},
    }
    if tool in DELAYED:
        kinds["delays"] = {"longest_delay": DELAYED[tool]}
    return kinds


def random_trace(
    tool: str,
    seed: int,
    control_steps: int = 60,
    timesteps: int = 1,
    longest_delay: int = 1,
    skips: bool = True,
) -> dict[str, Any]:
    """Network and input of a trace, without what the tool records.

    tool: of SOURCES.
    timesteps: of a control step.
    longest_delay: [timesteps] longest delay of a synapse between neurons; 1 leaves out `delays`.
    skips: whether the input reaches layers behind the first too.
    """
    rng = np.random.default_rng(seed)
    raster = np.zeros((control_steps, timesteps, SIZES[0]), np.int64)
    raster[:, 0] = rng.random((control_steps, SIZES[0])) < EVENTS
    layers = []
    for place, (fan_in, size) in enumerate(pairwise(SIZES)):
        layer = {"weights": _weights(rng, size, fan_in, -200 if place else -160)}
        if place and skips:
            layer["weights_input"] = _weights(rng, size, SIZES[0], -200)
        if longest_delay > 1:
            layer["delays"] = rng.integers(1, longest_delay + 1, (size, fan_in)).tolist()
        last = place == len(SIZES) - 2
        layers.append({**layer, **_neurons(tool, rng, size, last)})
    clock = "pipelined" if timesteps == 1 else f"free, {timesteps} timesteps a control step"
    return {
        "name": f"{tool} clock seed {seed}",
        "source": SOURCES[tool],
        "kind": f"random layers{', skips from the input' * skips}, a readout; clock {clock}",
        "input_spikes": raster.reshape(-1, SIZES[0]).tolist(),
        "layers": layers,
    }


def _weights(rng: np.random.Generator, size: int, fan_in: int, least: int) -> list[list[int]]:
    """Mantissas (size, fan_in); more of them positive, so that neurons spike."""
    return rng.integers(least, 256, (size, fan_in)).tolist()


def _neurons(tool: str, rng: np.random.Generator, size: int, readout: bool) -> dict[str, Any]:
    """Fields of a layer's neurons, by the names that the tool's traces have."""
    # registers: fast currents, slow membranes; of the readout nearly an integrator
    current = int(rng.integers(1000, 4095))
    membrane = 1 if readout else int(rng.integers(50, 1500))
    mantissa = OUT_OF_REACH if readout else int(rng.integers(150, 500))
    bias = 0 if readout else int(rng.integers(-200, 1500))
    if tool == "lava":
        neurons = {"du": current, "dv": membrane, "vth": mantissa, "bias_mant": bias}
        return {**neurons, "bias_exp": 0}
    if tool == "brian2_loihi":
        neurons = {"decay_u": current, "decay_v": membrane, "vth_mant": mantissa}
        return {**neurons, "refractory": 1}
    return {
        "decay_u": current,
        "decay_v": membrane,
        "vth_effective": mantissa << 6,
        "bias": bias,
        "refract_delay": 1,
        "vmin": -LARGEST,
        "vmax": LARGEST,
    }
