"""How many modules and names there are; what a load, a compilation and an action touch.

    python -m lab structure [--chip loihi1] [--policy spikedeploy/zoo/hexapod/popsan.nir]

Files touched are those of `runtime` in which a function runs; a border is a pair of folders of
`runtime` of which one calls the other.
"""

import argparse
import ast
import sys
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from types import FrameType

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("runtime", "envs", "trainers", "exporters", "spikedeploy")


def sources() -> Iterator[Path]:
    """Every file of this repository, where it stands and not through a link."""
    for package in PACKAGES:
        for path in sorted((ROOT / package).rglob("*.py")):
            if not any(parent.is_symlink() for parent in path.parents):
                yield path


def public(tree: ast.Module) -> Iterator[str]:
    """Public functions, classes and constants of a module, and public methods."""
    for node in tree.body:
        if isinstance(node, (ast.FunctionDef, ast.ClassDef)) and not node.name.startswith("_"):
            yield "class" if isinstance(node, ast.ClassDef) else "function"
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
            named = [n.name for n in node.body if isinstance(n, ast.FunctionDef)]
            yield from ("method" for name in named if not name.startswith("_"))
        if isinstance(node, (ast.Assign, ast.AnnAssign)):
            for target in node.targets if isinstance(node, ast.Assign) else [node.target]:
                names = [n.id for n in ast.walk(target) if isinstance(n, ast.Name)]
                yield from ("constant" for name in names if not name.startswith("_"))


def counts() -> Counter[str]:
    """Modules, without tables of contents, and public names."""
    found: Counter[str] = Counter()
    for path in sources():
        found["modules"] += path.name != "__init__.py"
        found["modules of runtime"] += (
            path.name != "__init__.py" and path.relative_to(ROOT).parts[0] == "runtime"
        )
        found.update(public(ast.parse(path.read_text(encoding="utf-8"))))
    return found


class Calls:
    """Files that run inside of `runtime`, and calls from one file or folder to another."""

    def __init__(self) -> None:
        self.files: set[str] = set()
        self.hops = 0
        self.borders: set[tuple[str, str]] = set()

    def of(self, work: Callable[[], object]) -> object:
        """Run the work and remember its calls."""
        sys.setprofile(self._profile)
        try:
            return work()
        finally:
            sys.setprofile(None)

    def _profile(self, frame: FrameType, event: str, _: object) -> None:
        here = _place(frame)
        if event != "call" or here is None:
            return
        self.files.add(here)
        caller = _place(frame.f_back) if frame.f_back else None
        if caller and caller != here:
            self.hops += 1
            one, other = (str(Path(place).parent) for place in (caller, here))
            if one != other:
                self.borders.add((one, other))

    def __str__(self) -> str:
        return f"{len(self.files)} files, {self.hops} hops, {len(self.borders)} folder borders"


def _place(frame: FrameType) -> str | None:
    """A file of `runtime`, by its path in the repository, or None."""
    path = Path(frame.f_code.co_filename).resolve()
    if not path.is_relative_to(ROOT / "runtime") or frame.f_code.co_name == "<module>":
        return None
    return path.relative_to(ROOT).as_posix()


def main() -> None:
    """Print the counts."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--chip", default="loihi1")
    parser.add_argument("--policy", default=str(ROOT / "spikedeploy/zoo/hexapod/popsan.nir"))
    given = parser.parse_args()
    from spikedeploy.runtime import SpikingController, load
    from spikedeploy.runtime.chips.chip import chip
    from spikedeploy.runtime.compiler.compile import compile_program

    for name, number in sorted(counts().items()):
        print(f"{name:<22}{number:>6}")
    on = chip(given.chip)
    load(given.policy), compile_program(load(given.policy), on)  # what is imported once is imported
    loading, compiling, acting = Calls(), Calls(), Calls()
    policy = loading.of(lambda: load(given.policy))
    compiling.of(lambda: compile_program(policy, on))
    controller = SpikingController(policy, on)
    observation = [0.0] * policy.codec.encoder.observed
    controller.act(observation)
    acting.of(lambda: controller.act(observation))
    for name, calls in (("load", loading), ("compile", compiling), ("act", acting)):
        print(f"{name:<22}{calls}")
        for file in sorted(calls.files):
            print(f"    {file}")
        for one, other in sorted(calls.borders):
            print(f"    {one} -> {other}")
