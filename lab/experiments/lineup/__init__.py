"""The lineup experiment: shipped policies that were distilled, trained again with other seeds.

design      which policies, with how many seeds
evaluation  the shipped file or a new training, on seeds that no training has seen
experiment  the missing parts, and the page
records     the table, results/lineup.csv
tables      each policy over its trainings, beside its teacher and the sparse policy
page        results/lineup.md
"""
