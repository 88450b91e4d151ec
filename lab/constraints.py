"""The tested set: the versions of every package that this environment has for spikedeploy.

    python -m lab constraints > spikedeploy/constraints.txt

Run it in the environment in which the whole suite has passed. It follows the requirements of
spikedeploy's extras through the installed metadata, so nothing else that is installed gets in. A
version that does not support every Python that we do says so in a marker.
"""

import argparse
import platform
import re
import sys
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet
from packaging.utils import canonicalize_name
from packaging.version import Version

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).resolve().parents[1]
EXTRAS = ("dev", "tune", "xylosim")
HEAD = """\
# The tested set: the versions with which the whole suite has passed, on {where}.
# Made by `python -m lab constraints > spikedeploy/constraints.txt` in that environment.
#
#     pip install -c constraints.txt ".[train]"
#
# `./spike` installs these. A line with a marker is for some versions of Python alone; on the others
# pip takes the newest version that pyproject.toml allows. Where a wheel is missing for a platform,
# leave out `-c constraints.txt`, or the line. torch has no `+cpu` here, so that plain pip finds it,
# and the wheel of any index will do.
"""
_OLDEST = (3, 10)
_EXTRA = r"extra\s*==\s*['\"]([^'\"]+)['\"]"


def main() -> None:
    """Print the file."""
    argparse.ArgumentParser(
        description=__doc__.splitlines()[0],
        epilog="It takes no options and prints the file.",
    ).parse_args()
    where = f"Python {platform.python_version()}, {platform.system()} {platform.machine()}"
    print(HEAD.format(where=where))
    for name in sorted(closure(), key=str.lower):
        print(line(name))


def closure() -> set[str]:
    """Return the names of all packages that the extras require, as far as they are installed."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    own: dict[str, list[str]] = {"": project["dependencies"], **project["optional-dependencies"]}
    todo = [Requirement(f"spikedeploy[{','.join(EXTRAS)}]")]
    found: set[str] = set()
    seen: set[tuple[str, str]] = set()
    while todo:
        wanted = todo.pop()
        name = canonicalize_name(wanted.name)
        for extra in {"", *wanted.extras} - {extra for of, extra in seen if of == name}:
            seen.add((name, extra))
            try:
                more = own[extra] if name == "spikedeploy" else required(name, extra)
            except PackageNotFoundError:
                continue
            todo += map(Requirement, more)
            found.add(name)
    return found - {"spikedeploy"}


def required(name: str, extra: str) -> list[str]:
    """Return the requirements of an installed package, those of an extra where one is named."""
    found = [(each, re.findall(_EXTRA, each)) for each in distribution(name).requires or ()]
    return [each for each, named in found if ((extra in named) if named else not extra)]


def line(name: str) -> str:
    """Return `numpy==2.4.6; python_version >= "3.11"`: a limit that excludes a supported Python."""
    found = distribution(name)
    marker = " and ".join(
        f'python_version >= "{clause.version}"'
        for clause in SpecifierSet(found.metadata.get("Requires-Python") or "")
        if clause.operator == ">=" and Version(clause.version).release[:2] > _OLDEST
    )
    return f"{name}=={found.version.partition('+')[0]}" + (f"; {marker}" if marker else "")
