"""Steps per second of the environments on one core, with random actions, resets included.

    python -m lab envs [NAME ...] [--track big_S] [--steps 20000] [--rounds 5] [--vector 8]

The environments take turns, round by round, and the medians of their rounds are printed with the
slowest and the fastest: of one environment, and of so many in a gymnasium SyncVectorEnv, whose
figure counts the steps of all of them. Without names, every kart is measured with its LIDAR on.

Of karts, PPO's rollouts are measured, too, with the recipes' spiking policies: observe, encode,
spike through all timesteps, draw an action, and step, in 16 copies.
"""

import argparse
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np

from spikedeploy import envs

KARTS = tuple(name for name in envs.ENVS if name.startswith("kart"))
Measure = Callable[[], float]


def single(name: str, options: dict[str, Any], steps: int) -> Measure:
    """What steps one environment, and gives its steps per second."""
    env = envs.make(name, **options)
    actions = _actions(env.action_space, steps)
    env.reset(seed=0)

    def measure() -> float:
        begin = time.perf_counter()
        for action in actions:
            _, _, terminated, truncated, _ = env.step(action)
            if terminated or truncated:
                env.reset()
        return steps / (time.perf_counter() - begin)

    return measure


def vector(name: str, options: dict[str, Any], steps: int, copies: int) -> Measure:
    """What steps several at once, and gives the steps per second of all of them."""
    makers = [partial(envs.make, name, **options)] * copies
    several = gymnasium.vector.SyncVectorEnv(makers)
    rounds = max(1, steps // copies)
    actions = _actions(several.action_space, rounds)
    several.reset(seed=0)

    def measure() -> float:
        begin = time.perf_counter()
        for action in actions:
            several.step(action)
        return rounds * copies / (time.perf_counter() - begin)

    return measure


def rollouts(recipe: str, options: dict[str, Any], steps: int) -> Measure:
    """What collects experience as PPO does, untrained, and gives its steps per second."""
    import torch

    from spikedeploy.trainers.config import resolve
    from spikedeploy.trainers.ppo import EpisodeLog, Ppo, PpoConfig
    from spikedeploy.trainers.run_folder import RunFolder

    torch.set_num_threads(1)
    folder = Path(tempfile.mkdtemp())
    settings = [f"env.options.{name}={value}" for name, value in options.items()]
    config = resolve(PpoConfig, recipe, overrides=settings)
    learner = Ppo(config, RunFolder.create(folder, config))
    log = EpisodeLog(folder / "episodes.csv", config.env.count)
    repeats = max(1, steps // (config.horizon * config.env.count))

    def measure() -> float:
        begin, before = time.perf_counter(), learner.env_steps
        for _ in range(repeats):
            learner.collect(log)
        return (learner.env_steps - before) / (time.perf_counter() - begin)

    return measure


def _actions(space: gymnasium.Space[Any], count: int) -> list[Any]:
    """So many random actions, drawn before the clock runs."""
    space.seed(0)
    return [space.sample() for _ in range(count)]


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("names", nargs="*", default=KARTS, metavar="NAME")
    parser.add_argument("--track", default="big_S", help="of the karts")
    parser.add_argument("--steps", type=int, default=20_000, help="in a round")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--vector", type=int, default=8, help="environments side by side")
    given = parser.parse_args()
    rows: dict[tuple[str, str], tuple[Measure, list[float]]] = {}
    for name in given.names:
        options = {"track": given.track} if name in KARTS else {}
        rows[name, "one"] = single(name, options, given.steps), []
        rows[name, f"{given.vector} of them"] = (
            vector(name, options, given.steps, given.vector),
            [],
        )
        if name in KARTS:
            rows[name, "PPO-SNN"] = rollouts(f"{name}-snn", options, given.steps), []
    for _ in range(given.rounds):
        for measure, found in rows.values():
            found.append(measure())
    print(f"steps per second, median (slowest - fastest) of {given.rounds} x {given.steps:,} steps")
    for (name, how), (_, found) in rows.items():
        print(
            f"{name:16} {how:10} {np.median(found):9,.0f}  ({min(found):,.0f} - {max(found):,.0f})"
        )
