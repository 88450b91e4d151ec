"""Campaigns: many jobs for one question, in a folder where they go on after a stop.

sweep_grid      SPEC.toml as jobs: axes, combinations that mean something, the key of each
sweep           missing jobs run and kept, a line each
sweep_page      the tables of a sweep: cells pooled over seeds, page, CSV
search_space    texts of --search as distributions, and the default search of a recipe
training_seeds  several seeds of one training, side by side
tune            a search with Optuna: trials, each trained and evaluated in a process
tune_page       its page with pictures
"""
