"""Pages that files name exist; a package that lists its modules lists them all."""

import ast
import re

import pytest

from tests.paths import ROOT

FILES = sorted(
    path
    for folder in ("envs", "examples", "exporters", "lab", "runtime", "spikedeploy", "trainers")
    for path in (ROOT / folder).rglob("*.py")
)
LISTS = {}  # package -> what its docstring lists, a line each: "name  what it is"
for _init in (path for path in FILES if path.name == "__init__.py"):
    _text = ast.get_docstring(ast.parse(_init.read_text("utf-8"))) or ""
    if _listed := re.findall(r"^ *(\w+(?:, \w+)*)(?:\.py|/)?  +\S", _text, re.M):
        LISTS[_init.parent] = ([*", ".join(_listed).split(", ")], set(re.findall(r"\w+", _text)))


def test_every_page_that_a_file_names_exists():
    named = {
        page for path in FILES for page in re.findall(r"\bdocs/[\w-]+\.md", path.read_text("utf-8"))
    }
    assert len(named) > 10
    assert [page for page in sorted(named) if not (ROOT / page).is_file()] == []


@pytest.mark.parametrize("package", LISTS, ids=lambda path: str(path.relative_to(ROOT)))
def test_a_package_that_lists_its_modules_lists_them_all(package):
    listed, words = LISTS[package]
    assert [
        n for n in listed if not any((package / f"{n}{end}").exists() for end in ("", ".py"))
    ] == []
    modules = {path.stem for path in package.glob("*.py")} - {"__init__", "__main__"}
    modules |= {path.parent.name for path in package.glob("*/__init__.py")}
    assert sorted(modules - words) == []
