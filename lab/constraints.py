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

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).resolve().parents[1]
EXTRAS = ("dev", "sweep", "tune", "xylosim")
HEAD = """\
# The tested set: the versions with which the whole suite has passed, on {where}.
# Made by `python -m lab constraints > spikedeploy/constraints.txt` in that environment.
#
#     pip install -c constraints.txt ".[train]"
#
# `./spike` installs these. A line with a marker is for some versions of Python alone; on the others
# pip takes the newest version that pyproject.toml allows. Where a wheel is missing for a platform,
# leave out `-c constraints.txt`, or the line. `spikedeploy doctor` says what differs. torch has
# no `+cpu` here, so that plain pip finds it, and the wheel of any index will do.
"""
_NAME = re.compile(r"[A-Za-z0-9._-]+")
_CLAUSE = re.compile(r"(>=|<=|<|>|==|!=|~=)\s*(\d+(?:\.\d+)*)")
_OLDEST = (3, 10)


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
    """Names of all packages that the extras require, as far as they are installed."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    table = project["optional-dependencies"]
    todo = list(project["dependencies"])
    todo += [f"spikedeploy[{extra}]" for extra in EXTRAS]
    found: set[str] = set()
    seen: set[tuple[str, str]] = set()
    while todo:
        name, extras = parsed(todo.pop())
        for extra in ["", *extras]:
            if (name, extra) in seen:
                continue
            seen.add((name, extra))
            if name == "spikedeploy":
                todo += table.get(extra, ())
                continue
            try:
                todo += required(name, extra)
            except PackageNotFoundError:
                continue
            found.add(name)
    return found


def parsed(requirement: str) -> tuple[str, list[str]]:
    """Name and extras of a requirement."""
    match = _NAME.match(requirement)
    if match is None:
        raise SystemExit(f"{requirement!r} is no requirement")
    name, rest = normal(match.group()), requirement[match.end() :].lstrip()
    extras = rest[1 : rest.index("]")].split(",") if rest.startswith("[") else []
    return name, [extra.strip() for extra in extras]


def normal(name: str) -> str:
    """The name as indexes spell it."""
    return re.sub(r"[-_.]+", "-", name).lower()


def required(name: str, extra: str) -> list[str]:
    """Requirements of an installed package, those of an extra where one is named."""
    wanted = []
    for each in distribution(name).requires or ():
        marker = each.partition(";")[2]
        named = re.findall(r"extra\s*==\s*['\"]([^'\"]+)['\"]", marker)
        if (extra in named) if named else not extra:
            wanted.append(each)
    return wanted


def line(name: str) -> str:
    """`numpy==2.4.6; python_version >= "3.11"`."""
    found = distribution(name)
    version = found.version.partition("+")[0]
    marker = " and ".join(
        f'python_version {sign} "{number}"'
        for sign, number in _CLAUSE.findall(found.metadata.get("Requires-Python") or "")
        if matters(sign, number)
    )
    return f"{name}=={version}" + (f"; {marker}" if marker else "")


def matters(sign: str, number: str) -> bool:
    """Whether a limit excludes a Python that we support; patch versions are left out."""
    parts = tuple(map(int, number.split(".")[:2]))
    return sign == ">=" and parts > _OLDEST
