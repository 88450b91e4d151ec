"""What a call takes, in numbers that do not depend on the machine: Python calls and memory."""

import sys
import tracemalloc
from contextlib import contextmanager


def calls_in(function, *given):
    """How many calls and returns, of Python and of C, happen in a call."""
    count = 0

    def counted(frame, event, argument):
        nonlocal count
        count += 1

    before = sys.getprofile()
    sys.setprofile(counted)
    try:
        function(*given)
    finally:
        sys.setprofile(before)
    return count


@contextmanager
def memory_below(limit):
    """Fail where the block takes more memory than this at any time [bytes]."""
    tracemalloc.start()
    try:
        yield
        assert tracemalloc.get_traced_memory()[1] < limit
    finally:
        tracemalloc.stop()
