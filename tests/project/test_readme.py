"""The Python of the front page runs, and the links of all pages lead somewhere."""

import re

import pytest

from tests.paths import ROOT

README = ROOT / "README.md"
PAGES = [
    README,
    ROOT / "CONTRIBUTING.md",
    *sorted(ROOT.glob("docs/**/*.md")),
    ROOT / "results/README.md",
]


def anchors(page):
    """What links within a page may name, as GitHub makes them of headings."""
    text = re.sub(r"^```.*?^```$", "", page.read_text("utf-8"), flags=re.M | re.S)
    heads = re.findall(r"^#+ (.*)$", text, re.M)
    return {re.sub(r"[^\w\- ]", "", head.lower()).replace(" ", "-") for head in heads}


def test_the_readmes_python_lets_the_robot_walk(monkeypatch, capsys, tmp_path):
    (tmp_path / "spikedeploy").symlink_to(ROOT / "spikedeploy")
    monkeypatch.chdir(tmp_path)
    (example,) = re.findall(r"```python\n(.*?)```", README.read_text("utf-8"), re.S)
    exec(example, {})
    total, sops = map(float, capsys.readouterr().out.split())
    assert total > 2500
    assert 0 < sops < 748_544 * 5
    assert (tmp_path / "walk.npz").exists()


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_lead_somewhere(page):
    links = re.findall(r"\]\(([^)#]+)(?:#[^)]*)?\)", page.read_text("utf-8"))
    near = [link for link in links if "://" not in link]
    assert [link for link in near if not (page.parent / link).exists()] == []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_to_headings_find_them(page):
    links = re.findall(r"\]\(([^)#]*\.md)?#([^)]+)\)", page.read_text("utf-8"))
    where = [(page.parent / name if name else page, anchor) for name, anchor in links]
    assert [anchor for file, anchor in where if anchor not in anchors(file)] == []


def test_the_index_names_every_page():
    named = re.findall(r"\]\(([\w/-]+\.md)\)", (ROOT / "docs/README.md").read_text("utf-8"))
    pages = {page.relative_to(ROOT / "docs").as_posix() for page in ROOT.glob("docs/**/*.md")}
    assert sorted(named) == sorted(pages - {"README.md"})
