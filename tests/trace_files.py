"""Recorded traces read in the two calls that `verify` makes."""

from spikedeploy.runtime.traces.fields import read_json
from spikedeploy.runtime.traces.verify import trace_in


def recorded_trace(path):
    """The trace in a file, checked."""
    return trace_in(read_json(path), path.stem)
