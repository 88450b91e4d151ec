"""The command line: a thin file for each command, which reads options and prints what is found.

The work is done in the other folders. A file imports only typer, rich and the standard library
when it is loaded, so that `--help` is quick; everything else is imported inside its function.

options      options that several commands share
demo         reports and films of shipped policies
compare      policies on the same seeds, with intervals and costs
run          one policy in its environment, closed loop
emulate      spike rasters into a network, open loop
check        a network against the design rules of chips
drift        a chip against the float twin, spike by spike
verify       recorded traces of emulators and chips against the emulator's arithmetic
train        a recipe becomes a run folder
export       a run folder becomes a file, compared with the policy
publish      a run becomes a shipped policy with its card
experiment   many trainings and evaluations
draw         a window to draw a track in
play         a window to drive in
replay       recorded episodes again, in a window or as video
visualize    learning curves as a picture
policies     shipped and built-in policies
chips        the chips that are emulated
energy       the energy tables
envs         the environments
recipes      the training recipes
doctor       what works on this machine
"""
