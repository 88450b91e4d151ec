"""Errors that a user can act on become one line."""

import re
import sys

import pytest

from spikedeploy import runtime
from spikedeploy.runtime import requirements
from spikedeploy.runtime.errors import ConfigError
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
        if extra in ("train", "fast", "serve", "events")
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


@pytest.mark.parametrize(
    ("package", "found", "said"),
    [
        ("nir", "1.0.4", "nir 1.0.4 is installed, and spikedeploy needs nir >=1.0.8,<2"),
        ("nir", "0.2", "nir 0.2 is installed"),
        ("h5py", "4.0.0", "h5py 4.0.0 is installed, and spikedeploy needs h5py >="),
        ("gymnasium", "0.29.1", "spikedeploy needs gymnasium >=1.0,<2"),
        ("nir", None, "spikedeploy needs nir, which is not installed: pip install 'nir>="),
    ],
)
def test_a_package_of_a_wrong_version_is_one_sentence(package, found, said, monkeypatch):
    installed = requirements._installed
    monkeypatch.setattr(
        requirements, "_installed", lambda name: found if name == package else installed(name)
    )
    with pytest.raises(ConfigError, match=re.escape(said)):
        requirements.check_requirements()
    runtime._check_once.cache_clear()
    with pytest.raises(ConfigError, match=re.escape(said)):
        runtime.load  # noqa: B018


def test_the_packages_of_these_tests_are_in_their_ranges():
    assert list(requirements.wrong_requirements()) == []


def test_an_attribute_that_is_not_there_stays_a_bug_where_all_versions_are_right(monkeypatch):
    monkeypatch.setattr(requirements, "_requirements", lambda: iter([("nir", ">=1.0.8,<2", False)]))
    assert one_line(AttributeError("no such thing")) is None
    monkeypatch.setattr(requirements, "_installed", lambda name: "1.0.4")
    assert "nir 1.0.4 is installed" in one_line(AttributeError("no such thing"))
