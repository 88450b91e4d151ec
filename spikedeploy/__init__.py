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
    recordings   episodes with all that a page replays of them
    reports      tables, plots and pages
    live         an episode in a browser while it is played
    realtime     a closed loop paced by the clock; policies that are served
    shipping     export, evaluations played again, the demo
    jobs         functions called in this process or in several, which Ctrl-C stops
    campaign     sweeps of evaluations, searches for settings, seeds of a training
    play         a window to drive a robot in, or to watch a policy

    console, outputs, user_errors    what is printed; which files may be written; errors as a line
    objects, training_settings       Python objects by name; recipe and settings of a training
    video                            frames as videos

    api          a few lines of Python; evaluation_setup: how policies are evaluated; cli starts
                 a command

`runtime`, `envs`, `trainers` and `exporters` stand at the top of the repository; in a checkout,
relative links lead to them. `load`, `compare`, `train` and `make` are imported when they are first
used, so that importing this package loads nothing.
"""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from spikedeploy.api import (
        ComparedPolicies,
        LoadedNetwork,
        NetworkRun,
        adapt,
        compare,
        distill,
        export,
        load,
        make,
        on_chip,
        train,
    )

    __version__: str

__all__ = [
    "ComparedPolicies",
    "LoadedNetwork",
    "NetworkRun",
    "__version__",
    "adapt",
    "compare",
    "distill",
    "export",
    "load",
    "make",
    "on_chip",
    "train",
]

if not TYPE_CHECKING:  # a type checker reads the imports above

    def __getattr__(name: str) -> object:
        """The public object called `name`, imported now."""
        if name not in __all__:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        if name == "__version__":
            from spikedeploy.trainers.versions import own

            return own()
        from spikedeploy.runtime.requirements import check_requirements

        check_requirements()
        from spikedeploy import api

        return getattr(api, name)

    def __dir__() -> list[str]:
        return sorted({*globals(), *__all__})
