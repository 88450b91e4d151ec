"""The command line: thin files, which read options and print what is found.

The work is done in the other folders. A file imports only typer, rich and the standard library
when it is loaded, so that `--help` is quick; everything else is imported inside its function.

options      options that several commands share
closed_loop  run, compare: policies in their environments
demo         demo
serving      serve
open_loop    emulate, drift: networks on recorded spikes
checks       check, doctor
replays      verify
evidence     reproduce
training     train, visualize
exporting    export, publish
training_seeds  train --seeds
runs         runs
distillation  distill
tuning       tune
sweeps       sweep
windows      play, replay, draw
listings     policies, chips, energy, envs, recipes
"""
