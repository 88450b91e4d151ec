"""From a trained spiking control policy to a neuromorphic chip: one namespace for everything.

    runtime      the chips: file, compiler, emulator, metrics; without torch and without physics
    envs         gymnasium environments, rollouts
    trainers     an environment in, a run folder out
    exporters    a trained policy in, a portable file out

    commands     the command line, a file for each command
    policies     policies of every format behind one interface
    zoo          the policies that are shipped
    comparison   policies on the same seeds, with intervals
    emulation    networks in open loop: rasters, drift, design rules, traces
    reports      tables, plots and pages
    shipping     export, publishing into the zoo, the demo
    experiments  many trainings and their evaluations by one command
    play         windows: drive, replay, draw a track

    cli          starts a command
    console      tables and JSON on stdout, progress on stderr
    files        files that are whole or not there
    make_env     environments with options, as the command line asks for them
    parallel     pure functions in processes side by side
    seeds        which seeds are for training, validation and evaluation
    user_errors  the one line that an error becomes
    video        MP4 files

`runtime`, `envs`, `trainers` and `exporters` stand at the top of the repository; in a checkout,
relative links lead to them.
"""
