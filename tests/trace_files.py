"""Recorded traces read in the two calls that `verify` makes."""

from spikedeploy.runtime.traces.verify import read_trace


def recorded_trace(path):
    """The trace in a file, checked."""
    return read_trace(path)
