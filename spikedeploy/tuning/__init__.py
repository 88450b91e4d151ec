"""`tune`: a search for the settings of a recipe, many trainings with Optuna (docs/tuning.md).

search       what a setting may be: a range or some choices
spaces       what is searched in a recipe unless it is said, and which keys there are
plan         the question: recipe, objective, settings
study        Optuna's record of it, in a file or a database
validations  reports the validations of a training and ends it where it is hopeless
trial        one training with its evaluation, in a process of its own
evaluation   return and synaptic operations of a run, on seeds that are for choosing
tune         the trials that are missing, some at a time
outcomes     the trials as plain data, the best one, the Pareto front
page         tune.md
plots        its pictures
"""
