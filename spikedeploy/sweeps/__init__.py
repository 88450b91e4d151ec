"""Sweeps: a grid of environments, policies, chips, bits, disturbances, faults and seeds.

grid           SPEC.toml read: what is varied, and the defaults
specification  one job of the grid as data, and its key
expansion      the grid as jobs: combinations that mean something, each once
evaluation     a job run: its episodes played, on whatever machine
backends       where jobs are run, by name
store          one file a job, checked when read; the journal of a sweep
sweep          what is missing is run, failures are kept, pages written as it goes
cells          jobs that differ in their seeds alone, pooled
page           the table, the CSV and the Markdown page
"""
