"""Notebooks hold what their pages say, and run from top to bottom."""

import pytest

from tests.project.notebooks import FILES, text
from tests.project.test_docs import checkout  # noqa: F401  the folder of the reader


@pytest.mark.parametrize("name", FILES)
def test_a_notebook_is_its_page(name):
    """Written anew by `python -m tests.project.notebooks`."""
    assert FILES[name].read_text("utf-8") == text(name)
