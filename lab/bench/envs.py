"""Steps per second of the environments on one core, with random actions, resets included.

    python -m lab envs [NAME ...] [--track big_S] [--steps 20000] [--rounds 5] [--vector 8]

The environments take turns, round by round, and the medians of their rounds are printed with the
slowest and the fastest: of one environment, and of so many in a gymnasium SyncVectorEnv, whose
figure counts the steps of all of them. Without names, every kart is measured with its LIDAR on.

Of karts, PPO's rollouts are measured, too, with the recipes' spiking policies: observe, encode,
spike through all timesteps, draw an action, and step, in 16 copies.

The name event-camera measures the camera of envs/event_camera.py alone: frames of 32x64 pixels per
second, of one camera and of 32, whose bright edges move. v2e, whose model it is, is not on PyPI, so
that no peer runs beside it.
"""

import itertools
import tempfile
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np

from lab.bench.turns import Act, interleave, parser_of, report
from spikedeploy import envs
from spikedeploy.envs.event_camera import EventCamera

_CAMERA, _PIXELS = "event-camera", (32, 64)
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


def frames_of(cameras: int, frames: int) -> Act:
    """A function that shows so many frames to each of some event cameras, with v2e's defaults."""
    camera = EventCamera((cameras, *_PIXELS), "v2e", range(cameras))
    x = np.arange(_PIXELS[1]) / _PIXELS[1]
    # a stripe that passes in 100 frames
    films = [np.where((x - n / 100) % 1 < 0.25, 200, 60).astype(np.uint8) for n in range(100)]
    shown = [np.broadcast_to(row, camera.shape) for row in films]
    time = itertools.count(1)

    def step() -> None:
        for n in range(frames):
            camera.process(shown[n % len(shown)], next(time) / 1000)

    return step


def rollouts(recipe: str, options: dict[str, Any], steps: int) -> tuple[Act, int]:
    """A function that collects experience as PPO does, untrained, and the number of its steps."""
    import torch

    from spikedeploy.trainers.config import resolve
    from spikedeploy.trainers.ppo import Ppo, PpoConfig
    from spikedeploy.trainers.run_folder import RunFolder

    torch.set_num_threads(1)
    settings = [f"env.options.{name}={value}" for name, value in options.items()]
    config = resolve(PpoConfig, recipe, overrides=[*settings])
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
        if name == _CAMERA:
            for many in (1, 32):
                each = max(1, given.steps // many)
                label = f"{name:16} {'one' if many == 1 else f'{many} of them':10}"
                rows[label] = frames_of(many, each), each * many
            continue
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
