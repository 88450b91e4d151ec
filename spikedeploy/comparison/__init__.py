"""Comparisons: policies on the same seeds, paired, with intervals.

agreement        How far a policy agrees with another, asked the same question and left to itse
compare          Paired comparison: every row of a line-up plays the same seeds, in processes s
comparison       The comparison: what every row's episodes say, beside those of its reference
costs            What an inference costs: spikes, operations, energy; a mean over the inference
episodes         One episode of one row of a comparison, as a job: a pure function of its speci
lineup           The line-up of a comparison: who plays, on which chip, and whom each is measur
measures         What is measured of an inference: events, NeuroBench's numbers, memory, time
metrics          What an episode's step infos say about the robot, one number a metric
statistics       Statistics of few episodes: interquartile mean, bootstrap intervals, paired di
summary          What a comparison means, in two or three sentences, for people who read nothin
"""
