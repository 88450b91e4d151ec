"""Record golden traces again with the tools that they come from, and compare every number.

    python -m lab record-traces [FILE.json …] [--tool xylosim] [--out FOLDER]
    python -m lab record-traces --random 10 --tool lava --out FOLDER

A trace holds its network and its input: both are given to the tool, and what it records must be
what the file holds. `--out` writes the traces as they are recorded now. `--random` makes networks
of several layers (lab/peers/random_networks.py) and records them, for `spikedeploy verify`. A tool
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
from pathlib import Path
from typing import Any

from lab.peers.random_networks import SOURCES, random_kinds, random_trace

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


def golden_traces() -> list[Path]:
    """The traces whose tool is here: not those of RTL, nor of a board, which others recorded.

    What our own commands put out (commands/) is no trace.
    """
    elsewhere = ("rtl", "board", "commands")
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
