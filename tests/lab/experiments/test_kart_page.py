"""results/kart.md is what the archives of its trainings say, to the last digit."""

import shlex
import sys

import pytest

from lab.experiments.kart import page
from lab.experiments.kart.design import asked
from lab.experiments.kart.trainings import unpack
from tests.paths import ROOT

RESULTS = ROOT / "results"
TABLES = [f"kart/{name}.csv" for name in ("learning", "driving", "tracks", "finishes")]


def command():
    """The words of the command at the top of the page."""
    lines = (RESULTS / "kart.md").read_text("utf-8").splitlines()
    return next(shlex.split(line) for line in lines if line.startswith("    python"))


@pytest.fixture(scope="module")
def remade(tmp_path_factory):
    """A folder with the page and its tables, made of the archives by the page's own command."""
    folder = tmp_path_factory.mktemp("kart")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.setattr(sys, "argv", command())
        design = asked({})
        for archive in sorted((RESULTS / "kart/trainings").glob("*.zip")):
            unpack(archive, folder / design.folder)
        page.write(design, folder / "results")
    return folder / "results"


@pytest.mark.parametrize("name", ["kart.md", *TABLES])
def test_the_page_is_made_of_the_archives(name, remade):
    assert (remade / name).read_text("utf-8") == (RESULTS / name).read_text("utf-8")
