"""Notebooks hold what their pages say."""

import pytest

from tests.lab.notebooks import FILES, text


@pytest.mark.parametrize("name", FILES)
def test_a_notebook_is_its_page(name):
    """Written anew by `python -m tests.lab.notebooks`."""
    assert FILES[name].read_text("utf-8") == text(name)
