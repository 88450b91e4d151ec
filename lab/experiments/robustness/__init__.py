"""The robustness experiment: what is left of a policy's return where world or chip are not as made.

experiment   which parts are missing, done in order
design       its disturbances and faults, and how many episodes
lineup       its policies
evaluation   rows of one part, a file each; resumed where it stopped
records      rows as CSV with what is kept of the undisturbed return, and back
tables       Markdown tables and sentences of them
plot         a panel for each disturbance and fault
page         results/robustness.md
"""
