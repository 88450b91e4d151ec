"""Recording a trace with a tool: a file for each, with `record(trace)` and PACKAGES."""
