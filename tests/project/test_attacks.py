"""Every case of docs/attacks.md is held by a test that is there, and runs."""

import ast
import re
from functools import cache

import pytest

from tests.paths import ROOT

PAGE = (ROOT / "docs/attacks.md").read_text("utf-8")
CASES = re.findall(r"^\| (?!case|---)(.+) \| `([^`]+\.py)::(\w+)` \|$", PAGE, re.M)


@cache
def functions(file):
    """The tests of a file, and the names of their decorators."""
    tree = ast.parse((ROOT / file).read_text("utf-8"))
    return {
        node.name: [ast.unparse(each) for each in node.decorator_list]
        for node in tree.body
        if isinstance(node, ast.FunctionDef)
    }


def test_every_row_names_a_test():
    rows = [line for line in PAGE.splitlines() if line.startswith("| ")]
    heads = sum(line == "| case | test |" for line in rows)
    assert len(rows) - heads == len(CASES) == len({case for case, *_ in CASES})
    assert len(CASES) > 60


@pytest.mark.parametrize(("file", "name"), sorted({case[1:] for case in CASES}))
def test_the_test_of_a_case_is_there_and_not_switched_off(file, name):
    found = functions(file)
    assert name in found, f"docs/attacks.md names {name}, which {file} has not"
    assert not [each for each in found[name] if "mark.skip(" in each or "xfail" in each]
