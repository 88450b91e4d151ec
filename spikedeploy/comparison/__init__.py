"""Comparisons: policies play the same seeds, and every row is paired with its reference.

A comparison becomes rows of plain data (`Comparison.as_json`), which `reports` shows.

lineup       which policies play, on which chip, and what each is measured against
rounds       every entry on every seed, in parallel, references first
closed_loop  one policy alone, with or without a video
episodes     one episode as a job: played, measured, summarised
comparison   the rows: returns, agreement, costs, metrics
agreement    how far two policies act alike, on the same observations and in closed loop
metrics      what the step infos of an episode say: speed, falls, lap time ...
statistics   bootstrap and Wilson intervals, interquartile mean, paired differences
summary      the result in two or three sentences
"""
