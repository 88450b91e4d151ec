"""What a release states in several places is the same everywhere."""

import re

import pytest

from spikedeploy.trainers.versions import own
from tests.paths import ROOT

if not (ROOT / "CITATION.cff").is_file():
    pytest.skip("needs a checkout", allow_module_level=True)


def stated(file, pattern):
    return re.search(pattern, (ROOT / file).read_text("utf-8"), re.M)[1]


def test_the_version_is_the_same_wherever_it_is_stated():
    version = stated("pyproject.toml", r'^version = "([\d.]+)"')
    assert stated("CITATION.cff", r"^version: ([\d.]+)$") == version
    assert stated("CHANGELOG.md", r"^## ([\d.]+) ") == version
    assert own() == version
