"""Models of Stable-Baselines3, saved by itself, with what its `predict` makes of observations.

    python -m lab sb3-models [FOLDER]

writes a .zip and a .npz (observation, action) for each algorithm into tests/golden/sb3, which
tests/trainers/distill/test_teachers.py reads. It needs stable-baselines3 and sb3-contrib, which
nothing else here does. Weights are drawn, not trained, so large that actions reach their bounds.
"""

import argparse
import zipfile
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np

FOLDER = Path(__file__).parents[2] / "tests" / "golden" / "sb3"
MODELS = {  # algorithm, environment, settings of the policy, use_sde
    "ppo": ("PPO", "CartPole-v1", {}, False),
    "dqn": ("DQN", "CartPole-v1", {}, False),
    "a2c": ("A2C", "reach", {"activation_fn": "ELU"}, False),
    "sac": ("SAC", "reach", {}, False),
    "td3": ("TD3", "reach", {"activation_fn": "GELU"}, False),
    "trpo": ("TRPO", "reach", {}, False),
    "crossq": ("CrossQ", "reach", {"batch_norm_eps": 0.01}, False),
    "ppo-expln": ("PPO", "reach", {"use_expln": True}, True),
    "a2c-squashed": ("A2C", "reach", {"squash_output": True}, True),
    "sac-gsde": ("SAC", "reach", {}, True),
    "sac-unclipped": ("SAC", "reach", {"clip_mean": 0.0}, True),
    "tqc-gsde": ("TQC", "reach", {"clip_mean": 0.5}, True),
    "crossq-gsde": ("CrossQ", "reach", {}, True),
}
LEFT_OUT = ("system_info.txt", "optimizer.pth")  # of the machine, and what nobody reads


def model(algorithm: str, env: str, policy: dict[str, Any], use_sde: bool) -> Any:  # noqa: ANN401
    """An untrained model with drawn weights."""
    import sb3_contrib
    import stable_baselines3
    import torch

    from tests.own_env import Reach

    library = stable_baselines3 if hasattr(stable_baselines3, algorithm) else sb3_contrib
    if "activation_fn" in policy:
        policy = {**policy, "activation_fn": getattr(torch.nn, policy["activation_fn"])}
    made = getattr(library, algorithm)(
        "MlpPolicy",
        Reach() if env == "reach" else gymnasium.make(env),
        policy_kwargs={"net_arch": [8, 6], **policy},
        device="cpu",
        **({"use_sde": True} if use_sde else {}),
    )
    rng = np.random.default_rng(12)
    for name, value in made.policy.named_parameters():
        value.data = torch.tensor(0.7 * rng.normal(size=value.shape), dtype=torch.float32)
        if name == "action_net.bias" and env == "reach" and "squash_output" not in policy:
            value.data += torch.tensor([-2.0, 7.0])  # into the bounds, which are odd
    for name, value in made.policy.named_buffers():  # means and variances of CrossQ
        if name.endswith(("ra_mean", "ra_var")):
            drawn = rng.normal(size=value.shape) ** 2 + 0.1
            value.data = torch.tensor(drawn, dtype=torch.float32)
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
