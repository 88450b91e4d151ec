"""The versions with which the whole suite has passed, against those that are installed."""

import re
import sys
from functools import cache
from importlib.resources import files

from spikedeploy.trainers.versions import installed_version

_LINE = re.compile(r"(?P<name>[\w.-]+)==(?P<version>[^;\s]+)(?P<markers>.*)")
_MARKER = re.compile(r'python_version >= "(\d+)\.(\d+)"')


@cache
def tested_versions() -> dict[str, str]:
    """Package -> tested version, of those lines of constraints.txt that are for this Python."""
    text = (files("spikedeploy") / "constraints.txt").read_text("utf-8")
    lines = [found for line in text.splitlines() if (found := _LINE.match(line))]
    return {line["name"]: line["version"] for line in lines if _is_for_us(line["markers"])}


def _is_for_us(markers: str) -> bool:
    return all(sys.version_info[:2] >= tuple(map(int, each)) for each in _MARKER.findall(markers))


def differences() -> list[str]:
    """`numpy 2.3.0 (tested: 2.4.6)` of each installed package that has another version."""
    found = {name: installed_version(name) for name in tested_versions()}
    return [
        f"{name} {version} (tested: {tested_versions()[name]})"
        for name, version in found.items()
        # 2.13.0+cpu is 2.13.0 from another index
        if version is not None and version.partition("+")[0] != tested_versions()[name]
    ]
