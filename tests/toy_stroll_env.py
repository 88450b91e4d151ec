"""An environment of twenty steps with two continuous actions, and small policies for it."""

from dataclasses import replace

import gymnasium
import numpy as np

from spikedeploy import envs, zoo
from spikedeploy.runtime.artifact.artifact import save
from spikedeploy.runtime.metadata import Provenance
from tests.networks import popsan

ID = "test/Stroll-v0"
ORIGIN = Provenance(ID, "smoke", seed=3, steps=7, created="2026-01-01T00:00:00Z", version="0.1.0")


class StrollEnv(gymnasium.Env):
    """Three observations drift with the two actions; action 0 is paid for following the first."""

    observation_space = gymnasium.spaces.Box(-10.0, 10.0, (3,), np.float64)
    action_space = gymnasium.spaces.Box(-1.0, 1.0, (2,), np.float64)
    metadata = {"render_modes": ["rgb_array"], "render_fps": 50}  # noqa: RUF012
    CONTROL_DT = 0.02
    max_steps = 20

    def __init__(self, render_mode=None, **options):
        self.render_mode = render_mode

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self._state, self._step, self._total = self.np_random.uniform(-1, 1, 3), 0, 0.0
        return self._state.copy(), {}

    def step(self, action):
        reward = 1.0 - float(abs(action[0] - np.tanh(self._state[0])))
        self._state = 0.9 * self._state + 0.1 * np.array([*action, 0.5])
        self._state += self.np_random.normal(0, 0.05, 3)
        self._step, self._total = self._step + 1, self._total + reward
        info = {
            "speed": 0.25, "cot": 2.0 / self._step, "heading": -0.5, "fall": False,
            "success": self._total > 15,
        }  # fmt: skip
        return self._state.copy(), reward, False, self._step == self.max_steps, info

    def render(self):
        return np.full((48, 64, 3), 10 * self._step, np.uint8)


def install(monkeypatch):
    """Make the world known as `stroll`."""
    spec = envs.EnvSpec("stroll", ID, "tests.toy_stroll_env:StrollEnv", "twenty steps", ("gait",))
    monkeypatch.setitem(envs.ENVS, "stroll", spec)
    envs.register()


def ship(monkeypatch, folder):
    """Make the world known, with a zoo in `folder` that ships a policy of each kind for it."""
    install(monkeypatch)
    monkeypatch.setattr(zoo, "FOLDER", folder)
    (folder / "stroll").mkdir(parents=True)
    ann(folder / "stroll/sac.onnx")
    snn(folder / "stroll/popsan.nir")
    return folder / "stroll"


def snn(path, env=ID, seed=0):
    """Write a spiking policy with random weights."""
    artifact = popsan(obs=3, act=2, hidden=(16, 12), seed=seed)
    save(replace(artifact, provenance=replace(ORIGIN, env=env)), path)
    return path


def run_folder(runs, policy, seed=0):
    """Make a run folder of an untrained policy, as a training of 5 steps would leave it."""
    import torch

    from spikedeploy.trainers.policies import from_config
    from spikedeploy.trainers.run_folder import RunFolder
    from spikedeploy.trainers.sac import SacConfig

    torch.manual_seed(seed)
    config = {"algorithm": "sac", "recipe": "smoke", "env": {"name": "stroll"}, "policy": policy}
    run = RunFolder.create(runs, SacConfig(**config))
    run.save("best", from_config(policy, observations=3, actions=2), {"env_steps": 5})
    run.metrics.write_text("env_steps,episode_return,eval_return\n2,1.0,\n5,2.0,3.0\n")
    return run.path


def ann(path, hidden=(8,), kind="ann", seed=0):
    """Write a float policy with random weights."""
    import torch

    from spikedeploy.exporters.to_onnx import to_onnx
    from spikedeploy.trainers.policies import MlpPolicy

    torch.manual_seed(seed)
    return to_onnx(MlpPolicy(3, 2, hidden=hidden), ORIGIN, path, kind=kind)
