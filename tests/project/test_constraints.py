"""The tested set, constraints.txt: whole, within what pyproject.toml allows."""

import re
import sys

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from tests.paths import ROOT

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

LINES = (ROOT / "constraints.txt").read_text("utf-8").splitlines()
PINS = dict(line.split(";")[0].strip().split("==") for line in LINES if re.match(r"[a-z]", line))
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
NEEDED = [
    each
    for each in [
        *PROJECT["dependencies"],
        *(r for e in ("train", "fast", "tune") for r in PROJECT["optional-dependencies"][e]),
    ]
    if not each.startswith("spikedeploy") and "python_version" not in each
]


def number(version):
    return tuple(int(part) for part in version.split("."))


@pytest.mark.parametrize("requirement", NEEDED)
def test_every_requirement_has_an_upper_bound_and_its_tested_version_is_within(requirement):
    name = canonicalize_name(Requirement(requirement).name)
    low = re.search(r">=([\d.]+)", requirement)[1]
    high = re.search(r"<([\d.]+)", requirement)[1]
    assert number(low) <= number(PINS[name]) < number(high)
