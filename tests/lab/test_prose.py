"""Paths, links and classes that the pages name are there."""

import ast
import re

import pytest

from tests.paths import ROOT

ARCHITECTURE = ROOT / "docs/architecture.md"
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted(ROOT.glob("docs/**/*.md"))]
FOLDERS = "runtime|envs|trainers|exporters|spikedeploy|lab|tests|examples"
PATH = rf"(?<![\w/.])((?:{FOLDERS})/[\w./-]*\w/?)(?![\w*<])"


def anchors(page):
    """What links may name, as GitHub makes them of headings."""
    text = re.sub(r"^```.*?^```$", "", page.read_text("utf-8"), flags=re.M | re.S)
    heads = re.findall(r"^#+ (.*)$", text, re.M)
    return {re.sub(r"[^\w\- ]", "", head.lower()).replace(" ", "-") for head in heads}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_paths_and_links_of_a_page_lead_somewhere(page):
    text = page.read_text("utf-8")
    named = set(re.findall(PATH, re.sub(r"spikedeploy/\w+-v\d", "", text)))
    assert sorted(path for path in named if not (ROOT / path).exists()) == []
    for link, anchor in re.findall(r"\]\((?!https?:|mailto:)([^)#\s]*)#?([^)\s]*)\)", text):
        target = page.parent / link if link else page
        assert target.exists(), link
        assert not anchor or target.suffix != ".md" or anchor in anchors(target), anchor


def test_the_index_names_every_page():
    named = re.findall(r"\]\(([\w/-]+\.md)\)", (ROOT / "docs/README.md").read_text("utf-8"))
    pages = {page.relative_to(ROOT / "docs").as_posix() for page in ROOT.glob("docs/**/*.md")}
    assert sorted(named) == sorted(pages - {"README.md"})


def test_the_classes_of_the_architecture_stand_where_it_says():
    table = re.findall(r"^\| `(\w+)` \| `([\w/]+\.py)` \|", ARCHITECTURE.read_text("utf-8"), re.M)
    assert len(table) > 20
    for name, file in table:
        tree = ast.parse((ROOT / file).read_text("utf-8"))
        assert name in {node.name for node in tree.body if isinstance(node, ast.ClassDef)}, file
