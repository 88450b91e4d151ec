"""Count the files that a reader goes through, until a policy first acts or first learns.

    python -m lab walk run      run hexapod/sparse, until its first `act`
    python -m lab walk train    train hexapod-sparse, until its first `backward`

Counts files of the product in which a function runs, the functions, and how often a call leads
from one file to another; then lists the files in the order in which they are met.
"""

import argparse
import inspect
import sys
import tempfile
from pathlib import Path
from types import FrameType

_ROOT = Path(__file__).resolve().parents[1]
_PACKAGES = tuple(f"{_ROOT / name}/" for name in
                  ("spikedeploy", "runtime", "envs", "trainers", "exporters"))  # fmt: skip
WALKS = {
    "run": (["run", "hexapod/sparse", "--seed", "10000"], "act"),
    "train": (["train", "hexapod-sparse", "--set", "teacher_walks=1", "--set", "noisy_walks=1",
               "--set", "validation.episodes=1"], "backward"),
}  # fmt: skip


class _Reached(BaseException):
    """The function to which the walk leads was called."""


class Walk:
    """Records calls until a function of the given name.

    files: of the product in which a function ran -> their functions, in order
    changes: number of calls from one file of the product to another
    """

    def __init__(self, end: str) -> None:
        self._end = end
        self._last = ""
        self.files: dict[str, set[str]] = {}
        self.changes = 0

    def __call__(self, frame: FrameType, event: str, _: object) -> None:
        """Take note of a call."""
        code = frame.f_code
        if event != "call" or not code.co_flags & inspect.CO_OPTIMIZED:  # bodies of modules
            return
        if code.co_filename.startswith(_PACKAGES):
            self.files.setdefault(code.co_filename, set()).add(
                f"{code.co_name}:{code.co_firstlineno}"
            )
            self.changes += code.co_filename != self._last
            self._last = code.co_filename
        elif code.co_name != "backward":  # of torch; the others are the product's
            return
        if code.co_name == self._end:
            sys.setprofile(None)
            raise _Reached


def main() -> None:
    """Walk, and print the counts and the files."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("walk", choices=WALKS)
    words, end = WALKS[parser.parse_args().walk]
    from spikedeploy.cli import main as command

    walk = Walk(end)
    with tempfile.TemporaryDirectory() as folder:
        sys.argv = ["spikedeploy", *words]
        if words[0] == "train":
            sys.argv += ["--runs", folder]
        sys.setprofile(walk)
        try:
            command()
        except _Reached:
            functions = sum(map(len, walk.files.values()))
            print(f"{len(walk.files)} files, {functions} functions, {walk.changes} changes of file")
    for path, functions_of in walk.files.items():
        print(f"{len(functions_of):4}  {Path(path).relative_to(_ROOT)}")
