"""Many jobs for one question: sweeps of evaluations, searches for settings, seeds of a training.

sweep_grid      SPEC.toml as jobs: axes, combinations that mean something, the key of each
sweep           missing jobs run and kept, one file each
sweep_page      the tables of a sweep: cells pooled over seeds, page, CSV
tune_plan       the question of a search: recipe, objective, settings and what they may be
tune            the search with Optuna: trials, each trained and evaluated in a process
tune_results    trials, the best of them, the page with pictures
training_seeds  one recipe with several seeds, side by side
"""
