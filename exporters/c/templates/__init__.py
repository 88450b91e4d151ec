"""Templates of C, with gaps `@NAME@`.

policy.h, policy.c      the network
codec.c                 observation to action; encode_*.c and decode.c are parts of it
selftest.c              compares with recorded numbers; run_*.c are parts of it
*_i16.c, policy_i16.h   the interface in 16-bit integers; dense_i16.c a network in 8-bit weights
cycles.*, README.md     what stands around; module.yml, zephyr.cmake, clayer.yml for build systems
Makefile                builds and runs the self-test, and a shared object
"""

import re
from collections.abc import Mapping
from importlib.resources import files

_GAP = re.compile(r"@([A-Za-z_]+)@")
# gaps may stand in what fills gaps
_DEPTH = 6


def template(name: str) -> str:
    """The text of a template."""
    return (files(__name__) / name).read_text(encoding="utf-8")


def fill(text: str, gaps: Mapping[str, str]) -> str:
    """A template without gaps; KeyError where nothing fills one."""
    for _ in range(_DEPTH):
        text, found = _GAP.subn(lambda gap: gaps[gap[1]], text)
        if not found:
            break
    # what is left out leaves no empty lines behind
    return re.sub(r"\n{3,}", "\n\n", text)
