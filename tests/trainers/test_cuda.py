import numpy as np
import pytest
import torch

from spikedeploy.runtime.errors import ConfigError
from spikedeploy.trainers.config import resolve
from spikedeploy.trainers.policies import MlpPolicy
from spikedeploy.trainers.sac.cuda import CudaLearner, CudaReplay
from spikedeploy.trainers.sac.learner import SacConfig

needs_gpu = pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device")
OBSERVATIONS, ACTIONS = 3, 2


def learner(*overrides):
    torch.manual_seed(0)
    settings = ["precision=float32", "device=cuda", "learning_rate=0.01", *overrides]
    config = resolve(SacConfig, "smoke", overrides=settings)
    return CudaLearner(config, MlpPolicy(OBSERVATIONS, ACTIONS, (16,)))


def filled(capacity=64, count=64, reward=1.0):
    rng = np.random.default_rng(0)
    replay = CudaReplay(capacity, OBSERVATIONS, ACTIONS)
    for _ in range(count // 16):
        replay.add(
            rng.normal(size=(16, OBSERVATIONS)),
            rng.uniform(-1, 1, (16, ACTIONS)),
            np.full(16, reward),
            np.ones(16, bool),
            rng.normal(size=(16, OBSERVATIONS)),
        )
    return replay


def updated(sac, replay, count, temperature=0.0):
    rng = np.random.default_rng(1)
    for _ in range(count):
        losses = sac.update(replay.sample(32, rng), temperature)
    return {name: float(loss) for name, loss in losses.items()}


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a CUDA device")
def test_without_a_gpu_the_setting_is_refused():
    with pytest.raises(ConfigError, match="finds no CUDA device; set device=cpu"):
        learner()


def test_a_gpu_with_low_precision_is_refused():
    with pytest.raises(ConfigError, match="set precision=float32"):
        resolve(SacConfig, "smoke", overrides=["precision=bfloat16", "device=cuda"])


@needs_gpu
def test_critics_converge_to_a_known_return_on_the_gpu():
    sac, replay = learner(), filled(reward=3.0)
    assert updated(sac, replay, 300)["critic_loss"] < 0.01


@needs_gpu
def test_a_captured_update_draws_new_noise_and_uses_the_new_batch():
    sac, replay = learner(), filled()
    first = updated(sac, replay, 10)
    assert updated(sac, replay, 1) != first


@needs_gpu
def test_the_scheduled_temperature_reaches_a_captured_update():
    sac, replay = learner(), filled()
    cold = updated(sac, replay, 10)["actor_loss"]
    hot = updated(sac, replay, 1, temperature=1_000.0)["actor_loss"]
    assert abs(hot) > 100 * abs(cold)


@needs_gpu
@pytest.mark.parametrize("count", [48, 64, 96])
def test_the_copy_of_the_replay_on_the_gpu_is_the_replay(count):
    replay = filled(count=count)
    assert np.array_equal(replay._copy.cpu().numpy(), replay.rows)


@needs_gpu
def test_actions_and_the_saved_policy_follow_the_actor():
    sac, replay = learner("averaging=1.0"), filled()
    updated(sac, replay, 20)
    sac.average(20)
    for _ in range(2):
        sac.explore(np.zeros((1, OBSERVATIONS)))
        torch.cuda.synchronize()
    sac.settle()
    seen = torch.ones(1, OBSERVATIONS)
    trained = sac.actor.policy(seen.cuda()).cpu()
    assert torch.allclose(sac.policy(seen), trained, atol=1e-5)
    assert torch.allclose(sac._follower.actor.policy(seen), trained, atol=1e-5)


@needs_gpu
def test_a_checkpoint_of_the_gpu_goes_on():
    one, replay = learner("learn_temperature=true"), filled()
    updated(one, replay, 10)
    one.settle()
    named = one.tensors() | {f"policy.{k}": v for k, v in one.policy.state_dict().items()}
    assert all(not tensor.is_cuda for tensor in named.values())
    other = learner("learn_temperature=true")
    other.load(named)
    assert other.temperature.value == one.temperature.value
    assert np.isfinite(updated(other, replay, 10)["critic_loss"])
