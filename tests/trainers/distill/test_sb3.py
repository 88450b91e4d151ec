"""Models of Stable-Baselines3, recorded by lab/peers/sb3_models.py of commit 548e02fb."""

import base64
import io
import json
import pickle
import zipfile

import numpy as np
import pytest
import torch
from gymnasium.spaces import Box

from spikedeploy import envs
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.trainers.distill import sb3
from spikedeploy.trainers.distill.teacher import OwnSpaces
from spikedeploy.trainers.distill.teachers import teacher
from tests.paths import ROOT

MODELS = ROOT / "tests/golden/sb3"
REACH, CARTPOLE = "tests.own_env:Reach", "CartPole-v1"
ENVS = {"a2c": REACH, "sac": REACH, "sac-gsde": REACH, "crossq": REACH}


def recorded(name):
    """Observations (64, obs) as policies see them, and what the model's `predict` gave."""
    with np.load(MODELS / f"{name}.npz") as file:
        return file["observation"].reshape(64, -1).astype(np.float64), file["action"]


def rewritten(name, path, change=None, **members):
    """A copy of a model whose JSON is changed, or whose members are others."""
    with zipfile.ZipFile(MODELS / f"{name}.zip") as source:
        found = {each: source.read(each) for each in source.namelist()}
    if change is not None:
        data = json.loads(found["data"])
        change(data)
        found["data"] = json.dumps(data)
    found |= {each.replace("_pth", ".pth"): content for each, content in members.items()}
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as target:
        for each, content in found.items():
            if content is not None:
                target.writestr(each, content)
    return str(path)


def refused(message, name, path, change=None, **members):
    with pytest.raises(ConfigError, match=message) as refusal:
        teacher(rewritten(name, path / "m.zip", change, **members), ENVS.get(name, CARTPOLE))
    assert "\n" not in str(refusal.value)
    return str(refusal.value)


def setting(*keys, value):
    def change(data):
        for key in keys[:-1]:
            data = data[key]
        data[keys[-1]] = value

    return change


def state_of(name, **changes):
    with zipfile.ZipFile(MODELS / f"{name}.zip") as archive:
        state = torch.load(io.BytesIO(archive.read("policy.pth")), weights_only=True)
    return {**state, **{key.replace("__", "."): value for key, value in changes.items()}}


def saved(content, **options):
    buffer = io.BytesIO()
    torch.save(content, buffer, **options)
    return buffer.getvalue()


CONTINUOUS = [
    "a2c", "sac", "td3", "trpo", "crossq", "ppo-expln", "a2c-squashed", "sac-gsde",
    "sac-unclipped", "tqc-gsde", "crossq-gsde",
]  # fmt: skip


@pytest.mark.parametrize("name", CONTINUOUS)
def test_continuous_actions_equal_those_of_predict_in_units_with_odd_bounds(name):
    observation, expected = recorded(name)
    env = envs.make(REACH)
    found = teacher(str(MODELS / f"{name}.zip"), REACH).act_all(observation)
    env.inner.reset(seed=0)
    given = []
    env.inner.unwrapped._left = 1_000
    for action in found:
        env.step(action)
        given.append(env.inner.unwrapped._given[-1])
    np.testing.assert_allclose(np.stack(given), expected, atol=2e-6)
    assert (np.ptp(expected, axis=0) > 0.15).all()


@pytest.mark.parametrize("name", ["gsde", "tqc"])
def test_gsde_and_tqc_of_a_user_give_the_actions_of_predict(name):
    low, high = np.array([0.0, -2.0], np.float32), np.array([10.0, 3.0], np.float32)
    own = OwnSpaces("asym", Box(-1.0, 1.0, (3,), np.float32), Box(low, high))
    found = sb3.sb3_teacher(str(MODELS / f"case-{name}.zip"), own)
    with np.load(MODELS / f"case-{name}.npz") as file:
        scaled = found.act_all(file["obs"].astype(np.float64))
        np.testing.assert_allclose(low + (scaled + 1) / 2 * (high - low), file["act"], atol=1e-6)
        assert np.ptp(file["act"], axis=0).min() > 5e-3


@pytest.mark.parametrize("name", ["ppo", "dqn"])
def test_discrete_choices_equal_those_of_predict(name):
    observation, expected = recorded(name)
    found = teacher(str(MODELS / f"{name}.zip"), CARTPOLE)
    assert (found.observations, found.actions) == (4, 2)
    np.testing.assert_array_equal(found.act_all(observation).argmax(-1), expected)
    assert 0.1 < expected.mean() < 0.9


def test_the_activation_function_is_the_files_own_or_the_algorithms(tmp_path):
    relu = "<class 'torch.nn.modules.activation.ReLU'>"
    observation, _ = recorded("a2c")
    elu = teacher(str(MODELS / "a2c.zip"), REACH).act_all(observation)
    path = rewritten(
        "a2c", tmp_path / "m.zip", setting("policy_kwargs", "activation_fn", value=relu)
    )
    assert not np.allclose(elu, teacher(path, REACH).act_all(observation))


class Evil:
    """Runs code when it is unpickled."""

    def __reduce__(self):
        return (exec, ("import pathlib; pathlib.Path('ran').touch()",))


def script():
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        archive.writestr("archive/constants.pkl", pickle.dumps(Evil()))
    return buffer.getvalue()


def test_nothing_in_a_file_is_run(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)

    def plant(data):
        code = base64.b64encode(pickle.dumps(Evil())).decode()
        for value in data.values():
            if isinstance(value, dict):
                value[":serialized:"] = code

    read = teacher(rewritten("ppo", tmp_path / "data.zip", plant), CARTPOLE)
    observation, expected = recorded("ppo")
    np.testing.assert_array_equal(read.act_all(observation).argmax(-1), expected)
    old = saved({"a": Evil()}, _use_new_zipfile_serialization=False)
    for content in (saved({"a": Evil()}), script(), old):
        refused("cannot be read", "ppo", tmp_path, policy_pth=content)
    assert not (tmp_path / "ran").exists()


def test_sizes_are_bounded_before_anything_is_decompressed(tmp_path, monkeypatch):
    monkeypatch.setattr(sb3, "_MAX_BYTES", {"data": 2**20, "policy.pth": 2**20})
    refused("data would unpack", "ppo", tmp_path, data=b" " * 2**23)
    inner = io.BytesIO()
    with zipfile.ZipFile(inner, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("archive/data.pkl", b" " * 2**21)
    refused("policy.pth would unpack", "ppo", tmp_path, policy_pth=inner.getvalue())
    wide = {"action_net.weight": torch.zeros(1).expand(2**20, 2**20)}
    refused("larger than their file", "ppo", tmp_path, policy_pth=saved(wide))


UNFIT = [
    ("dqn", ("policy_class", "__module__"), "sb3_contrib.qrdqn.policies", "QR-DQN"),
    ("a2c", ("policy_class", "__module__"), "sb3_contrib.ars.policies", "ARS"),
    ("ppo", ("policy_class", "__module__"), "sb3_contrib.common.recurrent.policies", "recurrent"),
    ("ppo", ("policy_class", "__module__"), "sb3_contrib.common.maskable.policies", "Maskable"),
    ("ppo", ("observation_space", ":type:"), "<class 'gymnasium.spaces.dict.Dict'>", "MultiInput"),
    ("ppo", ("policy_class", "__module__"), "mine.nets", r"of mine\.nets, not MlpPolicy"),
    ("ppo", ("policy_class",), None, "unknown class"),
    ("ppo", ("_last_original_obs",), {":type:": "numpy.ndarray"}, "VecNormalize"),
    ("a2c", ("policy_kwargs", "activation_fn"), "<class 'mine.Swish'>", "activation_fn.*Swish"),
    ("a2c", ("policy_kwargs", "features_extractor_class"), "<class 'mine.A'>", r"extractor.*mine"),
    ("a2c", ("policy_kwargs",), 5, "policy_kwargs"),
    ("ppo", ("policy_kwargs",), [], "policy_kwargs"),
    ("ppo", ("action_space", ":type:"), "<class 'gymnasium.MultiDiscrete'>", "takes a Discrete"),
    ("sac", ("action_space", "high"), "[[0.2]\n [9. ]]", r"high \[0\.2, 9\.0\].*has \[0\.1"),
    ("sac-gsde", ("policy_kwargs", "clip_mean"), True, "clip_mean"),
    ("sac-gsde", ("policy_kwargs", "clip_mean"), "2", "clip_mean"),
    ("sac-gsde", ("policy_kwargs", "clip_mean"), -1.0, "clip_mean"),
]


@pytest.mark.parametrize(("name", "keys", "value", "message"), UNFIT)
def test_a_policy_that_is_no_mlp_of_the_observation_is_refused(
    name, keys, value, message, tmp_path
):
    said = refused(message, name, tmp_path, setting(*keys, value=value))
    remedies = {"recurrent": "Train one without memory", "Maskable": "asks for the mask"}
    assert remedies.get(message, "Export the policy to ONNX, or name a function of yours") in said


@pytest.mark.parametrize(
    ("name", "changes", "message"),
    [
        ("ppo", {"features_extractor__cnn__0__weight": torch.zeros(2, 2)}, "CnnPolicy"),
        ("ppo", {"lstm_actor__weight_ih_l0": torch.zeros(2, 2)}, "recurrent"),
        ("ppo", {"mlp_extractor__policy_net__3__weight": torch.zeros(6)}, "not an MLP's"),
        ("ppo", {f"mlp_extractor__policy_net__{'9' * 5_000}__weight": torch.ones(2)}, "not an MLP"),
        ("ppo", {"mlp_extractor__policy_net__0__scale": torch.ones(2)}, "not an MLP's"),
        ("ppo", {"action_net__weight": torch.zeros(2, 5)}, "do not fit one another"),
        ("ppo", {"action_net__bias": torch.zeros(3)}, "no layer action_net with weight and bias"),
        ("ppo", {"action_net__bias": torch.tensor([np.nan, 0.0])}, "no finite floats"),
        ("ppo", {"action_net__bias": torch.zeros(2).to(torch.float8_e4m3fn)}, "no finite floats"),
        ("ppo", {"action_net__bias": torch.zeros(2, dtype=torch.int64)}, "no finite floats"),
        ("ppo", {"action_net__weight": torch.eye(2).to_sparse()}, "action_net.weight is sparse"),
        ("ppo", {"action_net__bias": torch.zeros(2, device="meta")}, "quantised or empty"),
        ("crossq", {"actor__latent_pi__3__ra_var": torch.ones(5)}, r"latent_pi\.3 does not fit"),
    ],
)
def test_layers_that_are_no_mlp_are_refused(name, changes, message, tmp_path):
    refused(message, name, tmp_path, policy_pth=saved(state_of(name, **changes)))


def test_a_model_for_another_kind_of_action_is_refused():
    for name, env, message in (
        ("ppo", REACH, "takes a Box"),
        ("sac", CARTPOLE, "takes a Discrete"),
    ):
        with pytest.raises(ConfigError, match=message):
            teacher(str(MODELS / f"{name}.zip"), env)
    with pytest.raises(ConfigError, match="leave teacher_units out"):
        teacher(str(MODELS / "sac.zip"), REACH, units="scaled")


def test_a_file_that_is_no_model_is_refused(tmp_path):
    whole = (MODELS / "ppo.zip").read_bytes()
    for content in (b"no zip", whole[:3_000], whole.replace(b"data", b"\xff\xfe\xfd\xfc")):
        (tmp_path / "a.zip").write_bytes(content)
        with pytest.raises(ConfigError, match="cannot be read as a model of Stable-Baselines3"):
            teacher(str(tmp_path / "a.zip"), CARTPOLE)
    for members, message in (
        ({"data": None}, "it has no data"),
        ({"policy_pth": None}, r"it has no policy\.pth"),
        ({"data": b"{"}, "cannot be read"),
        ({"data": b"[" * 100_000}, "cannot be read"),
        ({"data": b"[]"}, "data is no table"),
        ({"policy_pth": saved([1])}, "no state dict"),
        ({"policy_pth": saved({"a": 1})}, "no state dict"),
        ({"policy_pth": b"cut"}, "cannot be read"),
        ({"policy_pth": saved(state_of("ppo")).replace(b"data.pkl", b"\xff" * 8)}, "cannot be"),
    ):
        refused(message, "ppo", tmp_path, **members)
    with pytest.raises(ConfigError, match="there is no teacher at"):
        teacher(str(tmp_path / "none.zip"), CARTPOLE)
