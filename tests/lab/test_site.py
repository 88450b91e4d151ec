"""The site builds without a warning, has every page, and reading it fetches nothing."""

import os
import re
import subprocess
import sys

import pytest

from tests.paths import ROOT

for module in ("mkdocs", "material", "mkdocstrings"):
    pytest.importorskip(module, reason=f"needs {module}: pip install -e '.[docs]'")

# what a browser fetches by itself; links that a reader clicks may lead out
FETCHED = (
    r"<(?:script|img|iframe|source)\b[^>]*\bsrc=.(?:https?:)?//"
    r"|<link\b(?=[^>]*\brel=.(?:stylesheet|preload|icon))[^>]*\bhref=.(?:https?:)?//"
)


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The folder of the site; a warning, as of a link that leads nowhere, fails the build."""
    folder = tmp_path_factory.mktemp("site")
    words = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(folder)]
    environ = {**os.environ, "NO_MKDOCS_2_WARNING": "1"}
    done = subprocess.run(words, cwd=ROOT, env=environ, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return folder


def test_it_has_every_page_of_docs_and_the_api(site):
    names = {file.relative_to(site).with_suffix("").as_posix() for file in site.rglob("*.html")}
    docs = {page.relative_to(ROOT).with_suffix("").as_posix() for page in ROOT.glob("docs/*.md")}
    assert docs - {"docs/README"} <= names
    assert {"index", "docs/index", "results/pareto", "reference/spikedeploy.runtime"} <= names


def test_reading_it_fetches_nothing_from_elsewhere(site):
    for file in site.rglob("*.html"):
        assert not re.search(FETCHED, file.read_text("utf-8")), file
    for file in site.rglob("*.css"):
        text = file.read_text("utf-8")
        assert not re.search(r"@import|url\(['\"]?(https?:)?//", text), file
