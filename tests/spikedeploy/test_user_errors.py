"""Errors that a user can act on become one line."""

import re
import sys

import pytest

from spikedeploy.user_errors import EXTRAS, one_line
from tests.paths import ROOT

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib


def optional():
    """Package -> extra, of those extras of pyproject that our own modules import."""
    text = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    extras = tomllib.loads(text)["project"]["optional-dependencies"]
    return {
        re.match(r"[a-z]+", package)[0].replace("pyzmq", "zmq"): extra  # as it is imported
        for extra, packages in reversed(extras.items())  # the first that has it
        if extra in ("train", "fast", "sweep", "serve", "events")
        for package in packages
        if not package.startswith("spikedeploy[")
    }


def test_every_package_of_every_extra_is_known():
    assert optional() == EXTRAS


@pytest.mark.parametrize(("package", "extra"), EXTRAS.items())
def test_a_missing_package_names_the_extra_that_has_it(package, extra):
    error = ModuleNotFoundError(f"No module named '{package}'", name=f"{package}.core")
    expected = (
        f"this needs {package}, which is not installed: in the checkout of spikedeploy, "
        f'pip install ".[{extra}]"'
    )
    assert one_line(error) == expected


@pytest.mark.parametrize("name", ["experiment", "interop"])
def test_a_command_that_moved_to_the_lab_says_where_it_is(name, command):
    code, _, err = command(name, "--quick")
    assert (code, f"`python -m lab {name}`" in err) == (2, True)
