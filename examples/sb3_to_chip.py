"""From a model of Stable-Baselines3 to Loihi 1: a spiking student learns from the .zip file.

Where there is no such file yet, Stable-Baselines3 trains one, which needs it installed; to read a
file does not. Minutes on one core.

    python examples/sb3_to_chip.py [MODEL.zip] [ENV]
"""

import json
import sys
from collections.abc import Sequence
from pathlib import Path

import spikedeploy as sd
from spikedeploy.shipping.exported_run import runnable


def train_teacher(file: Path, env: str) -> None:
    """A teacher as its users train it."""
    from stable_baselines3 import PPO

    PPO("MlpPolicy", env, device="cpu", seed=0).learn(60_000).save(file)


def main(
    file: Path, env: str, settings: Sequence[str] = (), episodes: int = 20
) -> sd.ComparedPolicies:
    """Distil the model into 64-64 LIF neurons, and drive the environment with them on the chip."""
    if not file.is_file():
        train_teacher(file, env)
    teacher = f"teacher={json.dumps(str(file))}"
    run = sd.train("distill-snn", env=env, overrides=[teacher, *settings])
    return sd.compare(env, [runnable(str(run))], episodes=episodes)


if __name__ == "__main__":
    model, env, *_ = [*sys.argv[1:], *("ppo.zip", "CartPole-v1")[len(sys.argv) - 1 :]]
    print(main(Path(model), env))
