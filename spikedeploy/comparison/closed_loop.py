"""One policy in one environment, closed loop, with or without a video of it."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

from spikedeploy import envs
from spikedeploy.comparison.comparison import Comparison, Row
from spikedeploy.comparison.episodes import summarise
from spikedeploy.comparison.lineup import Entry, on_another_chip
from spikedeploy.console import progress, say
from spikedeploy.envs.rollout import rollout
from spikedeploy.make_env import confirm, disturbed_by, make_env
from spikedeploy.outputs import mark
from spikedeploy.policies.interface import DEFAULT_CHIP, FLOAT, Candidate
from spikedeploy.policies.registry import find, open_policy
from spikedeploy.realtime.paced_loop import PacedLoop
from spikedeploy.runtime.chips.quantisation import PLAIN, Quantisation
from spikedeploy.runtime.emulator.backend import BackendName
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.faults import NONE, Faults
from spikedeploy.video import Frame, Pace, captioned, mp4


def run_policy(
    reference: str,
    env: str | None,
    chip: str | None,
    seeds: Sequence[int],
    video: Path | None = None,
    sampled: bool = False,
    options: Mapping[str, Any] = MappingProxyType({}),
    limits: bool = True,
    quantisation: Quantisation = PLAIN,
    faults: Faults = NONE,
    metrics: Sequence[str] = (),
    loop: PacedLoop | None = None,
    backend: BackendName = "numpy",
) -> Comparison:
    """One row: the policy on every seed.

    reference  as registry.find takes it
    env        short name or id; None is the one that the policy was made for
    chip       a chip or "float"; None is that of the training, or DEFAULT_CHIP, for a file
               that spikes
    seeds      (n,)
    video      MP4 of the first episode
    sampled    draw one of several actions by its probability, instead of taking the likeliest
    options    of the environment
    limits     refuse what breaks a design rule of the chip
    quantisation  of a spiking policy on a chip
    faults     of that chip
    metrics    of the step infos, `name:mean|last|max`
    loop       paces it by the clock, and says which seeds are played; None plays as fast as it can
    backend    of a spiking policy on a chip
    """
    candidate = replace(
        find(reference), limits=limits, quantisation=quantisation, faults=faults, backend=backend
    )
    entry = Entry(candidate, chip or _default_chip(candidate))
    if faults and entry.chip in (None, FLOAT):
        raise ConfigError(
            f"--fault is of chips, and {entry.label} runs in float. Leave it out, or run a spiking "
            "policy on a chip."
        )
    if remark := on_another_chip(entry):
        say(remark)
    mode = "rgb_array" if video else None
    name = env or _made_for(candidate)
    foreign = envs.spec(name).foreign
    world: Any = make_env(name, options, render_mode=mode)
    player = (open_policy if loop is None else loop.open)(candidate, entry.chip, world, sampled)
    period = world.unwrapped.CONTROL_DT
    pace = Pace.of(period)
    episodes = []
    with progress(entry.label, len(seeds)) as done:
        for seed in seeds if loop is None else loop.seeds(seeds):
            with _film(video if seed == seeds[0] else None, pace.fps, entry.label) as on_frame:
                if loop is None:
                    played = rollout(world, player, seed, on_frame, pace.every)
                else:
                    played = loop.rollout(world, player, seed)
            episodes.append(summarise(candidate, player, played, {}, metrics, foreign))
            done()
    world.close()
    rows, disturb = [Row(entry, episodes)], disturbed_by(options)
    if loop is not None:  # it may have played more
        seeds = range(seeds[0], seeds[0] + len(episodes))
    return Comparison(played.env_id, seeds, rows, (), disturb, foreign, period if foreign else None)


def _made_for(candidate: Candidate) -> str:
    if candidate.env is None:
        raise ConfigError(f"{candidate.path} does not say for which environment: give --env")
    confirm(candidate.env, None, candidate.path)
    return candidate.env


def _default_chip(candidate: Candidate) -> str | None:
    if candidate.kind != "snn":
        return None
    return candidate.chip or DEFAULT_CHIP if candidate.format == ".nir" else FLOAT


@contextmanager
def _film(path: Path | None, fps: float, caption: str) -> Iterator[Callable[[Frame], None] | None]:
    """What `rollout` calls with each frame; None without a path."""
    if path is None:
        yield None
        return
    with mp4(path, fps, mark("run")) as write:
        yield lambda frame: write(captioned(frame, caption))
