"""Packages keep to their budgets of lines, budgets.toml."""

import sys

import pytest

from tests.paths import ROOT

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

BUDGETS = tomllib.loads((ROOT / "budgets.toml").read_text("utf-8"))


def lines(package):
    """Lines of Python of a package; links to others are not followed."""
    return sum(file.read_text("utf-8").count("\n") for file in (ROOT / package).rglob("*.py"))


@pytest.mark.parametrize("package", BUDGETS)
def test_a_package_keeps_to_its_budget(package):
    assert 0 < lines(package) <= BUDGETS[package]
