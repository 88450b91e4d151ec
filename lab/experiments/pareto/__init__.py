"""The pareto experiment: return against operations and energy, sparse policies and their baselines.

experiment   which parts are missing, done in order of importance
design       its trainings and evaluations
training     one training by imitation, found, resumed or started
tuning       one training with reward after it, likewise
evaluation   all missing rows of one training, and of the references
networks     a policy on a chip or in few bits, for a batch of robots, with what it did
costs        energies of a row, term by term
records      rows as CSV, and back
fronts       means over training seeds with intervals, and the cheapest baselines
tables       Markdown tables and sentences of them
levels       the table of every level
overview     the table over all tasks
plot         the front drawn
page         results/pareto.md
"""
