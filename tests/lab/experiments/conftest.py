"""Experiments whose jobs run in the test's process."""

import pytest

from spikedeploy.jobs import resumable
from tests.job_functions import in_this_process


@pytest.fixture(scope="module")
def ran():
    """The names of the jobs that ran, each in this process."""
    names = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(resumable, "run", in_this_process(names))
        patch.setattr("lab.experiments.runner._EVERY", -1.0)
        yield names
