"""Comparisons: policies play the same seeds, and every row is paired with its reference.

A comparison becomes rows of plain data (`Comparison.as_json`), which `reports` shows.

evaluation       which policies play, on which chip; every entry on every seed; or one policy
episodes         one episode as a job: played, measured, compared with those of its references
comparison       the rows: returns, agreement, costs, energies, metrics
episode_metrics  numbers of an episode from its step infos: speed, falls, lap time ...
statistics       bootstrap and Wilson intervals, interquartile mean, paired differences
"""
