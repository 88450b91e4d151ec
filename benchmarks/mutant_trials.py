"""Each fault in a process of its own, with the tests that reach its line until one fails.

The process is a copy (fork) of one that has collected the tests and imported everything. In the
copy the code of one function is replaced by that with the fault; nothing is written to the disk.
"""

import gc
import os
import resource
import signal
import sys
from collections.abc import Callable, Iterator, Mapping
from types import CodeType, FunctionType
from typing import Literal

import pytest

from benchmarks.mutant_operators import ROOT, Mutant, mutated

Fate = Literal["killed", "too long", "survived", "unreached"]

_MEMORY = 16 * 2**30  # [bytes] of address space, most of it libraries
_SURVIVED, _KILLED, _NOWHERE = 0, 1, 3


def in_copy(work: Callable[[], int], seconds: int) -> int | None:
    """Exit status of the work in a copy of this process; None where it took longer [CPU s]."""
    sys.stdout.flush()
    if not (pid := os.fork()):
        status = _KILLED
        try:
            _limit(seconds)
            status = work()
        finally:
            os._exit(status)
    _, ended = os.waitpid(pid, 0)
    if os.WIFSIGNALED(ended):
        return None if os.WTERMSIG(ended) in (signal.SIGXCPU, signal.SIGALRM) else _KILLED
    return os.WEXITSTATUS(ended)


def _limit(seconds: int) -> None:
    """Bound time and memory of this process, and silence it."""
    resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds + 5))
    resource.setrlimit(resource.RLIMIT_AS, (_MEMORY, _MEMORY))
    signal.alarm(20 * seconds)  # one that sleeps
    nowhere = os.open(os.devnull, os.O_WRONLY)
    for stream in (1, 2):
        os.dup2(nowhere, stream)


def try_mutant(
    mutant: Mutant, tests: Mapping[pytest.Item, float], run: Callable[[pytest.Item], bool]
) -> Fate:
    """What the tests find; tests: with their seconds, in the order in which they run."""
    if not tests:
        return "unreached"

    def work() -> int:
        if not put_in(mutant):
            return _NOWHERE
        return _SURVIVED if all(run(item) for item in tests) else _KILLED

    status = in_copy(work, int(20 + 10 * sum(tests.values())))
    if status == _NOWHERE:
        raise RuntimeError(f"no function was found for {mutant.key}")
    return "too long" if status is None else "survived" if status == _SURVIVED else "killed"


def put_in(mutant: Mutant) -> bool:
    """Replace the code of the function that has the fault; whether there is one."""
    source = (ROOT / mutant.path).read_text("utf-8")
    before = _functions(compile(source, mutant.path, "exec"))
    after = _functions(compile(mutated(mutant), mutant.path, "exec"))
    # in the outermost functions; what is defined within them is part of their code
    changed = {place: after[place] for place in before if before[place] != after[place]}
    found = False
    gc.unfreeze()  # what is frozen is not listed
    for function in gc.get_objects():
        # isinstance would ask objects for their class, at which deprecated ones of torch warn
        if type(function) is not FunctionType:
            continue
        code = function.__code__
        new = changed.get((code.co_name, code.co_firstlineno))
        if new and os.path.realpath(code.co_filename) == str(ROOT / mutant.path):
            function.__code__ = new.replace(co_filename=code.co_filename)
            found = True
    return found


def _functions(code: CodeType) -> dict[tuple[str, int], CodeType]:
    """Name and first line -> code of the functions of a module and its classes."""
    return {(each.co_name, each.co_firstlineno): each for each in _outermost(code)}


def _outermost(code: CodeType) -> Iterator[CodeType]:
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            # bodies of classes have no optimised locals
            if constant.co_flags & 1:
                yield constant
            else:
                yield from _outermost(constant)
