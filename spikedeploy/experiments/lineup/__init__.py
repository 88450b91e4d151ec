"""The lineup experiment: shipped policies that were distilled, trained again with other seeds.

design      which policies, with how many seeds
evaluation  the shipped file or a new training, on seeds that no training has seen
experiment  the missing parts, and the page
page        results/lineup.md
"""
