"""From a trained spiking control policy to a neuromorphic chip: one namespace for everything.

    runtime     the chips: file, compiler, emulator, metrics; without torch and without physics
    envs        the worlds: gymnasium environments, rollouts
    trainers    torch in, run folder out
    exporters   a trained policy in, a portable file out
    commands    the command line, a file a verb

`runtime`, `envs`, `trainers` and `exporters` stand at the top of the repository; in a checkout,
relative links lead to them.
"""
