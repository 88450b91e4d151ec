"""The command line: thin files, which read options and print what is found.

The work is done in the other folders. A file imports only typer, rich and the standard library
when it is loaded, so that `--help` is quick; everything else is imported inside its function.

options      options that several commands share; a function as a command
closed_loop  run, compare, play, demo, serve, reproduce: policies in their environments
open_loop    emulate, drift, check, verify: networks without an environment
training     train, distill, tune, sweep, runs, visualize
distillation recipe and settings that `distill` means, and what came of it
adapting     adapt: a network trained on through a chip
exporting    export
listings     policies, chips, energy, envs, recipes, doctor
"""
