"""Waiting for another process or thread. A busy machine takes long: no test is about how long."""

import time

PATIENCE = 300.0  # [s] after which nothing will come


def wait_until(condition):
    """Return as soon as the condition holds, and fail where it never does."""
    until = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < until, "what was waited for did not come"
        time.sleep(0.02)
