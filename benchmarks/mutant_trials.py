"""Each fault in a process of its own, with the tests that reach its line until one fails.

The process is a copy (fork) of one that has imported numpy, pytest and other large libraries, but
nothing of ours; so the file is imported with its fault, and nothing is written to the disk.
"""

import contextlib
import importlib
import importlib.machinery
import os
import resource
import signal
import sys
import warnings
from collections.abc import Mapping, Sequence
from importlib.abc import MetaPathFinder
from typing import Any, Literal

import pytest

from benchmarks.mutant_operators import ROOT, Mutant, mutated

Fate = Literal["killed", "too long", "survived", "unreached"]

_LARGE = ("numpy", "h5py", "nir", "gymnasium", "hypothesis", "torch", "onnx", "onnxruntime")
_MEMORY = 16 * 2**30  # [bytes] of address space, most of it libraries
_SURVIVED, _KILLED = 0, 1


def import_large() -> None:
    """Import what takes long, once; the copies have it."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for name in _LARGE:
            with contextlib.suppress(ImportError):
                importlib.import_module(name)
    from hypothesis import Phase, settings

    # the same examples for each fault; a smaller example of a failure is of no use here
    settings.register_profile(
        "mutants", derandomize=True, database=None, phases=(Phase.explicit, Phase.generate)
    )
    settings.load_profile("mutants")


def try_mutant(mutant: Mutant, groups: Sequence[Mapping[str, float]]) -> Fate:
    """What the tests find; groups: name -> seconds, in the order in which they run."""
    if not groups:
        return "unreached"
    seconds = 30 + 10 * sum(sum(group.values()) for group in groups)
    if not (pid := os.fork()):
        _child(mutant, [list(group) for group in groups], int(seconds))
    _, status = os.waitpid(pid, 0)
    if os.WIFSIGNALED(status):
        in_time = os.WTERMSIG(status) not in (signal.SIGXCPU, signal.SIGALRM)
        return "killed" if in_time else "too long"
    return "killed" if os.WEXITSTATUS(status) else "survived"


def _child(mutant: Mutant, groups: Sequence[Sequence[str]], seconds: int) -> None:
    """Run the tests on the fault; exit."""
    resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds + 5))
    resource.setrlimit(resource.RLIMIT_AS, (_MEMORY, _MEMORY))
    signal.alarm(8 * seconds)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    for stream in (1, 2):
        os.dup2(nowhere, stream)
    code = _KILLED
    try:
        sys.meta_path.insert(0, _Finder(mutant))
        code = _SURVIVED if all(map(_pass, groups)) else _KILLED
    finally:
        os._exit(code)


def _pass(tests: Sequence[str]) -> bool:
    """Whether none of the tests fails."""
    files = list(dict.fromkeys(test.split("::")[0] for test in tests))
    found = pytest.main(["-x", "-q", "-p", "no:cacheprovider", *files], [_Chosen(tests)])
    return found in (0, 5)  # 5: no test was there to run


class _Chosen:
    """A plugin that leaves the named tests, in their order."""

    def __init__(self, tests: Sequence[str]) -> None:
        self._order = {test: place for place, test in enumerate(tests)}

    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        kept = [item for item in items if item.nodeid in self._order]
        items[:] = sorted(kept, key=lambda item: self._order[item.nodeid])


class _Finder(MetaPathFinder):
    """Gives one module its fault."""

    def __init__(self, mutant: Mutant) -> None:
        self._mutant = mutant
        self._name = "spikedeploy." + mutant.path.removesuffix(".py").replace("/", ".")
        self._name = self._name.removesuffix(".__init__")

    def find_spec(self, fullname: str, path: Any, target: Any = None) -> Any:
        if fullname != self._name:
            return None
        spec = importlib.machinery.PathFinder.find_spec(fullname, path)
        if spec and spec.origin:
            if os.path.realpath(spec.origin) != str(ROOT / self._mutant.path):
                raise ImportError(f"{fullname} is {spec.origin}, not {self._mutant.path}")
            spec.loader = _Loader(fullname, spec.origin, self._mutant)
        return spec


class _Loader(importlib.machinery.SourceFileLoader):
    """Compiles the file with its fault."""

    def __init__(self, name: str, path: str, mutant: Mutant) -> None:
        super().__init__(name, path)
        self._mutant = mutant

    def get_code(self, fullname: str) -> Any:
        return compile(mutated(self._mutant), self.get_filename(fullname), "exec")
