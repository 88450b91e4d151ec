"""Models of Stable-Baselines3, saved by itself, with what its `predict` makes of observations.

    python -m lab sb3-models [FOLDER]

writes a .zip and a .npz (observation, action) for each algorithm into tests/golden/sb3, which
tests/trainers/distill/test_teachers.py reads. It needs stable-baselines3, which nothing else
here does. Weights are drawn, not trained, so large that actions reach their bounds.
"""

import argparse
import zipfile
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np

FOLDER = Path(__file__).parents[2] / "tests" / "golden" / "sb3"
MODELS = {
    "ppo": ("PPO", "CartPole-v1", {}),
    "dqn": ("DQN", "CartPole-v1", {}),
    "a2c": ("A2C", "reach", {"activation_fn": "ELU"}),
    "sac": ("SAC", "reach", {}),
    "td3": ("TD3", "reach", {"activation_fn": "GELU"}),
}
LEFT_OUT = ("system_info.txt", "optimizer.pth")  # of the machine, and what nobody reads


def model(algorithm: str, env: str, policy: dict[str, str]) -> Any:  # noqa: ANN401
    """An untrained model with drawn weights."""
    import stable_baselines3
    import torch

    from tests.own_env import Reach

    settings = {name: getattr(torch.nn, value) for name, value in policy.items()}
    made = getattr(stable_baselines3, algorithm)(
        "MlpPolicy",
        Reach() if env == "reach" else gymnasium.make(env),
        policy_kwargs={"net_arch": [8, 6], **settings},
        device="cpu",
    )
    rng = np.random.default_rng(12)
    for name, value in made.policy.named_parameters():
        value.data = torch.tensor(0.7 * rng.normal(size=value.shape), dtype=torch.float32)
        if name == "action_net.bias" and env == "reach":  # into the bounds, which are odd
            value.data += torch.tensor([-2.0, 7.0])
    return made


def observations(space: gymnasium.spaces.Box) -> np.ndarray:
    """Observations (64, ...), the same for all models of a space."""
    drawn = np.random.default_rng(6).normal(size=(64, *space.shape))
    return drawn.astype(space.dtype)


def record(name: str, folder: Path) -> None:
    """Write a model and its actions."""
    made = model(*MODELS[name])
    whole = folder / f"{name}-whole.zip"
    made.save(whole)
    with zipfile.ZipFile(whole) as source, zipfile.ZipFile(folder / f"{name}.zip", "w") as target:
        for each in source.infolist():
            if not each.filename.endswith(LEFT_OUT):
                found = zipfile.ZipInfo(each.filename)
                target.writestr(found, source.read(each), zipfile.ZIP_DEFLATED)
    whole.unlink()
    seen = observations(made.observation_space)
    action, _ = made.predict(seen, deterministic=True)
    np.savez(folder / f"{name}.npz", observation=seen, action=action)


def main() -> None:
    """Record all of them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", nargs="?", type=Path, default=FOLDER)
    folder = parser.parse_args().folder
    folder.mkdir(parents=True, exist_ok=True)
    for name in MODELS:
        record(name, folder)
