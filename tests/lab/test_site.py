"""The site builds without a warning, its links lead somewhere, and reading it fetches nothing."""

import os
import re
import subprocess
import sys
from html.parser import HTMLParser
from urllib.parse import unquote, urlsplit

import pytest

from tests.paths import ROOT

for module in ("mkdocs", "material", "mkdocstrings"):
    pytest.importorskip(module, reason=f"needs {module}: pip install -e '.[docs]'")

# attributes of what a browser fetches by itself; links that a reader clicks may lead out
FETCHED = {
    ("script", "src"),
    ("img", "src"),
    ("link", "href"),
    ("iframe", "src"),
    ("source", "src"),
}


class Page(HTMLParser):
    """Ids, links, and what is fetched, of a page."""

    def __init__(self, text):
        super().__init__()
        self.ids, self.links, self.fetched = set(), [], []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        values = dict(attrs)
        self.ids |= {values[key] for key in ("id", "name") if values.get(key)}
        if tag == "a" and values.get("href"):
            self.links.append(values["href"])
        canonical = values.get("rel") in ("canonical", "next", "prev")
        self.fetched += [
            values[key]
            for kind, key in FETCHED
            if kind == tag and values.get(key) and not canonical
        ]


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The folder of the site, and the lines that its building prints."""
    folder = tmp_path_factory.mktemp("site")
    words = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(folder)]
    environ = {**os.environ, "NO_MKDOCS_2_WARNING": "1"}
    done = subprocess.run(words, cwd=ROOT, env=environ, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return folder, done.stderr


@pytest.fixture(scope="module")
def pages(site):
    folder, _ = site
    texts = {file: file.read_text("utf-8") for file in folder.rglob("*.html")}
    return {file.resolve(): Page(text) for file, text in texts.items() if file.stem != "404"}


def test_it_has_every_page_of_docs_and_the_api(pages, site):
    names = {file.relative_to(site[0].resolve()).with_suffix("").as_posix() for file in pages}
    docs = {page.relative_to(ROOT).with_suffix("").as_posix() for page in ROOT.glob("docs/**/*.md")}
    assert docs - {"docs/README"} <= names
    assert {"index", "docs/index", "results/pareto", "reference/spikedeploy.runtime"} <= names


def test_every_link_within_it_leads_somewhere(pages, site):
    dead = [
        f"{file.name}: {link}" for file, page in pages.items() for link in page.links
        if not leads(link, file, page, pages)
    ]  # fmt: skip
    assert dead == []


def leads(link, file, page, pages):
    """Whether there is the file, and in it the heading, that a link names."""
    parts = urlsplit(link)
    if parts.scheme:
        return True
    target = (file.parent / unquote(parts.path)).resolve() if parts.path else file
    target = target / "index.html" if target.is_dir() else target
    wanted = pages.get(target)
    return target.is_file() and (
        wanted is None or not parts.fragment or unquote(parts.fragment) in wanted.ids
    )


def test_reading_it_fetches_nothing_from_elsewhere(pages, site):
    folder = site[0].resolve()
    assert {
        each for page in pages.values() for each in page.fetched if urlsplit(each).scheme
    } == set()
    styles = [file.read_text("utf-8") for file in folder.rglob("*.css")]
    assert not any(re.search(r"@import|url\(['\"]?(https?:)?//", text) for text in styles)
