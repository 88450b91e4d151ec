"""Golden traces, exports and kits, recorded with the tools that they come from.

live_peers         all comparisons, each tool in an environment of its own
record_traces      golden traces recorded again, and random ones; traces/ has a file for each tool
exported_networks  networks exported by the tools themselves
kits               kits of `export --to program`, run with the tools that they are for
"""
