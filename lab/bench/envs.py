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

KARTS = tuple(name for name, spec in envs.ENVS.items() if spec.world == "kart")


def steps_of(env: Any, steps: int) -> Act:  # noqa: ANN401
    """A function that steps an environment so many times, by actions that were drawn before."""
    env.action_space.seed(0)
    actions = [env.action_space.sample() for _ in range(steps)]
    env.reset(seed=0)
    several = hasattr(env, "num_envs")  # which reset themselves

    def step() -> None:
        for action in actions:
            _, _, terminated, truncated, _ = env.step(action)
            if not several and (terminated or truncated):
                env.reset()

    return step


def rollouts(recipe: str, options: dict[str, Any], steps: int) -> tuple[Act, int]:
    """A function that collects experience as PPO does, untrained, and the number of its steps."""
    import torch

    from spikedeploy.trainers.config import resolve
    from spikedeploy.trainers.ppo import Ppo, PpoConfig
    from spikedeploy.trainers.run_folder import RunFolder

    torch.set_num_threads(1)
    settings = [f"env.options.{name}={value}" for name, value in options.items()]
    config = resolve(PpoConfig, recipe, overrides=[*settings, "ghosts=false"])
    learner = Ppo(config, RunFolder.create(Path(tempfile.mkdtemp()), config))
    each = config.horizon * config.env.count
    repeats = max(1, steps // each)
    return lambda: [learner.collect() for _ in range(repeats)], repeats * each


def main() -> None:
    """Measure and print."""
    parser = parser_of(__doc__, rounds=5)
    parser.add_argument("names", nargs="*", default=KARTS, metavar="NAME")
    parser.add_argument("--track", default="big_S", help="of the karts")
    parser.add_argument("--steps", type=int, default=20_000, help="in a round")
    parser.add_argument("--vector", type=int, default=8, help="environments side by side")
    given = parser.parse_args()
    copies, rounds = given.vector, max(1, given.steps // given.vector)
    rows: dict[str, tuple[Act, int]] = {}
    for name in given.names:
        options = {"track": given.track} if name in KARTS else {}
        make = partial(envs.make, name, **options)
        several = gymnasium.vector.SyncVectorEnv([make] * copies)
        rows[f"{name:16} one       "] = steps_of(make(), given.steps), given.steps
        rows[f"{name:16} {f'{copies} of them':10}"] = steps_of(several, rounds), rounds * copies
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
