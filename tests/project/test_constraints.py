"""The tested set, constraints.txt: whole, within what pyproject.toml allows, known to `doctor`."""

import re
import sys

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from spikedeploy import tested_set
from spikedeploy.commands import listings
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


@pytest.fixture
def versions(monkeypatch):
    """What is installed: everything as tested, unless it is said."""
    found = dict(tested_set.tested_versions())
    monkeypatch.setattr(tested_set, "installed_version", found.get)
    return found


def test_doctor_says_which_versions_differ_from_the_tested_set(versions):
    assert "no version differs" in listings._tested().detail
    versions["numpy"], versions["h5py"] = "1.99.0", None  # what is missing differs from nothing
    found = listings._tested()
    assert found.ok is None
    assert found.detail.startswith("1 differ: numpy 1.99.0 (tested: ")
    assert "pip install -c constraints.txt" in found.detail


def test_a_build_of_the_same_version_from_another_index_does_not_differ(versions):
    versions["torch"] += "+cu130"
    assert tested_set.differences() == []


def test_pins_for_newer_pythons_are_nothing_to_older_ones(monkeypatch):
    monkeypatch.setattr(tested_set.sys, "version_info", (3, 10, 13))
    tested_set.tested_versions.cache_clear()
    assert "numpy" not in tested_set.tested_versions()
    assert tested_set.tested_versions()["torch"] == PINS["torch"]
    tested_set.tested_versions.cache_clear()
