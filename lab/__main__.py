"""`python -m lab NAME …`: run one of the experiments, benchmarks or comparisons.

Imports the standard library only, so that it starts in the environments of other tools.
"""

import os
import sys
from importlib import import_module
from pathlib import Path

# command -> its module, whose main() reads the command line and may return an exit code
COMMANDS = {
    "tables": "lab.tables",
    "chips": "lab.experiments.chips",
    "clocks": "lab.experiments.clocks",
    "digits": "lab.experiments.digits",
    "energy": "lab.experiments.energy",
    "own-networks": "lab.experiments.own_networks",
    "students": "lab.experiments.students",
    "convolutions": "lab.bench.convolutions",
    "latency": "lab.bench.latency",
    "runtime": "lab.bench.runtime",
    "updates": "lab.bench.updates",
    "versions": "lab.bench.versions",
    "firmware": "lab.firmware.policies",
    "interop": "lab.interop.page",
    "exported-networks": "lab.peers.exported_networks",
    "kits": "lab.peers.kits",
    "live-peers": "lab.peers.live_peers",
    "record-traces": "lab.peers.record_traces",
    "publish": "lab.publish",
    "walk": "lab.walk",
    "constraints": "lab.constraints",
}
_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
_ROOT = str(Path(__file__).resolve().parents[1])


def main() -> int | None:
    """Run the command that is named; return its exit code."""
    words = sys.argv[1:]
    if not words or words[0] in ("-h", "--help"):
        print("usage: python -m lab NAME …\n\nNAME --help says more of each:")
        print("\n".join(f"  {name}" for name in COMMANDS))
        return None
    if words[0] not in COMMANDS:
        print(f"error: no {words[0]!r} in lab; there are {', '.join(COMMANDS)}", file=sys.stderr)
        return 2
    for name in _THREADS:  # before numpy and torch load; times are compared on one thread
        os.environ[name] = "1"
    # processes that are started find lab in whatever folder they run
    paths = [path for path in os.environ.get("PYTHONPATH", "").split(os.pathsep) if path]
    os.environ["PYTHONPATH"] = os.pathsep.join(dict.fromkeys([_ROOT, *paths]))
    sys.argv = [f"python -m lab {words[0]}", *words[1:]]
    try:
        code: int | None = import_module(COMMANDS[words[0]]).main()
    except Exception as error:
        if (line := _sentence(error)) is None:
            raise
        print(f"error: {line}", file=sys.stderr)
        return 2
    return code


def _sentence(error: Exception) -> str | None:
    """The line for the user; None of a bug, whose traceback is needed."""
    try:
        from spikedeploy.user_errors import one_line
    except ImportError:  # the environment of another tool
        return None
    return one_line(error)


if __name__ == "__main__":
    sys.exit(main())
