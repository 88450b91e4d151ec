"""Steps per second of the environments on one core, with random actions, resets included.

    python -m lab envs [NAME ...] [--track big_S] [--steps 20000] [--rounds 5] [--vector 8]

The environments take turns, round by round, and the medians of their rounds are printed with the
slowest and the fastest: of one environment, and of so many in a gymnasium SyncVectorEnv, whose
figure counts the steps of all of them. Without names, every kart is measured with its LIDAR on.

Of karts, PPO's rollouts are measured, too, with the recipes' spiking policies: observe, encode,
spike through all timesteps, draw an action, and step, in 16 copies.
"""

import tempfile
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np

from lab.bench.turns import Act, interleave, parser_of, report
from spikedeploy import envs

KARTS = tuple(name for name in envs.ENVS if name.startswith("kart"))


def single(name: str, options: dict[str, Any], steps: int) -> tuple[Act, int]:
    """A function that steps one environment so many times, and that number."""
    env = envs.make(name, **options)
    actions = _actions(env.action_space, steps)
    env.reset(seed=0)

    def step() -> None:
        for action in actions:
            _, _, terminated, truncated, _ = env.step(action)
            if terminated or truncated:
                env.reset()

    return step, steps


def vector(name: str, options: dict[str, Any], steps: int, copies: int) -> tuple[Act, int]:
    """A function that steps several at once, and the steps of all of them."""
    several = gymnasium.vector.SyncVectorEnv([partial(envs.make, name, **options)] * copies)
    rounds = max(1, steps // copies)
    actions = _actions(several.action_space, rounds)
    several.reset(seed=0)

    def step() -> None:
        for action in actions:
            several.step(action)

    return step, rounds * copies


def rollouts(recipe: str, options: dict[str, Any], steps: int) -> tuple[Act, int]:
    """A function that collects experience as PPO does, untrained, and the number of its steps."""
    import torch

    from spikedeploy.trainers.config import resolve
    from spikedeploy.trainers.ppo import Ppo, PpoConfig
    from spikedeploy.trainers.run_folder import RunFolder

    torch.set_num_threads(1)
    folder = Path(tempfile.mkdtemp())
    settings = [f"env.options.{name}={value}" for name, value in options.items()]
    config = resolve(PpoConfig, recipe, overrides=[*settings, "ghosts=false"])
    learner = Ppo(config, RunFolder.create(folder, config))
    each = config.horizon * config.env.count
    repeats = max(1, steps // each)

    def collect() -> None:
        for _ in range(repeats):
            learner.collect()

    return collect, repeats * each


def _actions(space: gymnasium.Space[Any], count: int) -> list[Any]:
    """So many random actions, drawn before the clock runs."""
    space.seed(0)
    return [space.sample() for _ in range(count)]


def main() -> None:
    """Measure and print."""
    parser = parser_of(__doc__, rounds=5)
    parser.add_argument("names", nargs="*", default=KARTS, metavar="NAME")
    parser.add_argument("--track", default="big_S", help="of the karts")
    parser.add_argument("--steps", type=int, default=20_000, help="in a round")
    parser.add_argument("--vector", type=int, default=8, help="environments side by side")
    given = parser.parse_args()
    rows: dict[str, tuple[Act, int]] = {}
    for name in given.names:
        options = {"track": given.track} if name in KARTS else {}
        several = f"{name:16} {f'{given.vector} of them':10}"
        rows[f"{name:16} one       "] = single(name, options, given.steps)
        rows[several] = vector(name, options, given.steps, given.vector)
        if name in KARTS:
            rows[f"{name:16} PPO-SNN   "] = rollouts(f"{name}-snn", options, given.steps)
    taken = interleave({name: [act] for name, (act, _) in rows.items()}, given.rounds)
    rates = {name: (rows[name][1] / np.array(times)).tolist() for name, times in taken.items()}
    report(rates, given, table)


def table(rates: dict[str, list[float]]) -> str:
    """The rates as lines."""
    lines = ["steps per second, median (slowest - fastest) of the rounds"]
    for name, each in rates.items():
        lines.append(f"{name} {np.median(each):9,.0f}  ({min(each):,.0f} - {max(each):,.0f})")
    return "\n".join(lines)
