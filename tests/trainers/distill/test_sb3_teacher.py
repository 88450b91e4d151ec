"""Stable-Baselines3's models, as it saved them: equal actions, and what is refused.

tests/golden/sb3 was recorded by lab/peers/sb3_models.py.
"""

import base64
import io
import json
import pickle
import zipfile

import numpy as np
import pytest
import torch

from spikedeploy import envs
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.trainers.distill import sb3
from spikedeploy.trainers.distill.sb3 import _members
from spikedeploy.trainers.distill.teachers import teacher
from tests.paths import ROOT

MODELS = ROOT / "tests/golden/sb3"
REACH, CARTPOLE = "tests.own_env:Reach", "CartPole-v1"


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


def state_of(name):
    with zipfile.ZipFile(MODELS / f"{name}.zip") as archive:
        return torch.load(io.BytesIO(archive.read("policy.pth")), weights_only=True)


def saved(content):
    buffer = io.BytesIO()
    torch.save(content, buffer)
    return buffer.getvalue()


@pytest.mark.parametrize("name", ["a2c", "sac", "td3"])
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
    assert (np.ptp(expected, axis=0) > 0.3).all()


@pytest.mark.parametrize("name", ["ppo", "dqn"])
def test_discrete_choices_equal_those_of_predict(name):
    observation, expected = recorded(name)
    found = teacher(str(MODELS / f"{name}.zip"), CARTPOLE)
    assert (found.observations, found.actions) == (4, 2)
    np.testing.assert_array_equal(found.act_all(observation).argmax(-1), expected)
    assert 0.1 < expected.mean() < 0.9


def test_ppo_teaches_by_its_logits_and_dqn_by_its_choice():
    observation, _ = recorded("ppo")
    assert len(np.unique(teacher(str(MODELS / "ppo.zip"), CARTPOLE).act_all(observation))) > 60
    assert len(np.unique(teacher(str(MODELS / "dqn.zip"), CARTPOLE).act_all(observation))) == 2


def test_the_activation_function_is_the_files_own_or_the_algorithms(tmp_path):
    def relu(data):
        data["policy_kwargs"]["activation_fn"] = "<class 'torch.nn.modules.activation.ReLU'>"

    observation, _ = recorded("a2c")
    elu = teacher(str(MODELS / "a2c.zip"), REACH).act_all(observation)
    other = teacher(rewritten("a2c", tmp_path / "relu.zip", relu), REACH).act_all(observation)
    assert not np.allclose(elu, other)


class Evil:
    """Runs code when it is unpickled."""

    def __reduce__(self):
        return (exec, ("import pathlib; pathlib.Path('ran').touch()",))


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

    weights = rewritten("ppo", tmp_path / "weights.zip", policy_pth=saved({"a": Evil()}))
    with pytest.raises(ConfigError, match="holds more than weights"):
        teacher(weights, CARTPOLE)
    script = io.BytesIO()
    with zipfile.ZipFile(script, "w") as archive:
        archive.writestr("archive/constants.pkl", pickle.dumps(Evil()))
    with pytest.raises(ConfigError, match="script of torch, which runs code"):
        teacher(rewritten("ppo", tmp_path / "script.zip", policy_pth=script.getvalue()), CARTPOLE)
    old = io.BytesIO()
    torch.save({"a": Evil()}, old, _use_new_zipfile_serialization=False)
    with pytest.raises(ConfigError, match=r"format of torch before 1\.6"):
        teacher(rewritten("ppo", tmp_path / "old.zip", policy_pth=old.getvalue()), CARTPOLE)
    pickled = tmp_path / "vecnormalize.pkl"
    pickled.write_bytes(pickle.dumps(Evil()))
    with pytest.raises(ConfigError, match=r"is a pickle, which could run code .*own-teacher\.md"):
        teacher(str(pickled), CARTPOLE)
    assert not (tmp_path / "ran").exists()


def test_sizes_are_bounded_before_anything_is_decompressed(tmp_path, monkeypatch):
    monkeypatch.setattr(sb3, "_MAX_BYTES", {"data": 2**20, "policy.pth": 2**20})
    bomb = rewritten("ppo", tmp_path / "bomb.zip", data=b" " * 2**23)
    with pytest.raises(ConfigError, match="data has more than 1 MiB"):
        teacher(bomb, CARTPOLE)
    inner = io.BytesIO()
    with zipfile.ZipFile(inner, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("archive/data.pkl", b" " * 2**21)
    with pytest.raises(ConfigError, match=r"policy\.pth has more than 1 MiB"):
        teacher(rewritten("ppo", tmp_path / "in.zip", policy_pth=inner.getvalue()), CARTPOLE)
    wide = {"action_net.weight": torch.zeros(1).expand(2**20, 2**20)}
    with pytest.raises(ConfigError, match="larger than their file"):
        teacher(rewritten("ppo", tmp_path / "wide.zip", policy_pth=saved(wide)), CARTPOLE)


def test_a_bomb_is_refused_by_its_header_alone(tmp_path, monkeypatch):
    bomb = rewritten("ppo", tmp_path / "bomb.zip", policy_pth=bytes(2**24))
    order = dict.fromkeys(("policy.pth", "data"), 2**28)  # the bomb is looked at first
    monkeypatch.setattr(sb3, "_MAX_BYTES", order)
    monkeypatch.setattr(zipfile.ZipFile, "open", lambda *_: pytest.fail("was decompressed"))
    with pytest.raises(ConfigError, match=r"policy\.pth would unpack from [\d,]+ to 16,777,216"):
        _members(bomb)


def test_a_bomb_among_the_weights_is_refused(tmp_path):
    inner = io.BytesIO()
    with zipfile.ZipFile(inner, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("archive/data.pkl", bytes(2**24))
    path = rewritten("ppo", tmp_path / "in.zip", policy_pth=inner.getvalue())
    with pytest.raises(ConfigError, match=r"policy\.pth would unpack from"):
        teacher(path, CARTPOLE)


def setting(*keys, value):
    def change(data):
        for key in keys[:-1]:
            data = data[key]
        data[keys[-1]] = value

    return change


RECURRENT = "sb3_contrib.common.recurrent.policies"
REFUSED = {
    "recurrent": ("ppo", setting("policy_class", "__module__", value=RECURRENT), "is recurrent"),
    "dictionary": (
        "ppo",
        setting("observation_space", ":type:", value="<class 'gymnasium.spaces.dict.Dict'>"),
        "is a MultiInputPolicy",
    ),
    "own class": (
        "ppo",
        setting("policy_class", "__module__", value="mine.nets"),
        r"its policy is of mine\.nets, not MlpPolicy",
    ),
    "no class": ("ppo", setting("policy_class", value=None), "its policy is of an unknown class"),
    "exploration": ("a2c", setting("use_sde", value=True), "state-dependent exploration"),
    "normalised": (
        "ppo",
        setting("_last_original_obs", value={":type:": "<class 'numpy.ndarray'>"}),
        "trained behind VecNormalize, whose statistics are in a pickle",
    ),
    "activation": (
        "a2c",
        setting("policy_kwargs", "activation_fn", value="<class 'mine.Swish'>"),
        r"its activation function is <class 'mine\.Swish'>; known are Tanh",
    ),
    "extractor": (
        "a2c",
        setting("policy_kwargs", "features_extractor_class", value="<class 'mine.Squares'>"),
        r"its features extractor is <class 'mine\.Squares'>, not FlattenExtractor",
    ),
    "no settings": ("a2c", setting("policy_kwargs", value=5), "policy_kwargs are no table"),
    "listed settings": ("ppo", setting("policy_kwargs", value=[]), "policy_kwargs are no table"),
    "several choices": (
        "ppo",
        setting("action_space", ":type:", value="<class 'gymnasium...MultiDiscrete'>"),
        "takes a Discrete",
    ),
    "other bounds": (
        "sac",
        setting("action_space", "high", value="[[0.2]\n [9. ]]"),
        r"trained for actions with high \[0\.2, 9\.0\], and tests\.own_env:Reach has \[0\.1",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_a_policy_that_is_no_mlp_of_the_observation_is_refused_with_the_remedy(case, tmp_path):
    name, change, message = REFUSED[case]
    path = rewritten(name, tmp_path / "model.zip", change)
    with pytest.raises(ConfigError, match=message) as refusal:
        teacher(path, REACH if name in ("a2c", "sac") else CARTPOLE)
    assert "Export the policy to ONNX, or name a function of yours" in str(refusal.value)


def weights(**changes):
    state = state_of("ppo")
    return {**state, **{name.replace("__", "."): value for name, value in changes.items()}}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"features_extractor__cnn__0__weight": torch.zeros(2, 2)}, "such as a CnnPolicy's"),
        ({"lstm_actor__weight_ih_l0": torch.zeros(2, 2)}, "is recurrent"),
        ({"mlp_extractor__policy_net__3__weight": torch.zeros(6)}, "not an MLP's"),
        ({"action_net__weight": torch.zeros(2, 5)}, "do not fit one another"),
        ({"action_net__bias": torch.zeros(3)}, "no layer action_net with weight and bias"),
        ({"action_net__bias": torch.tensor([np.nan, 0.0])}, "no finite numbers"),
        ({"action_net__bias": torch.zeros(2).to(torch.float8_e4m3fn)}, "torch.float8_e4m3fn"),
        ({"action_net__bias": torch.zeros(2, dtype=torch.int64)}, "torch.int64, no floats"),
        ({"action_net__weight": torch.eye(2).to_sparse()}, "action_net.weight is sparse"),
        ({"action_net__bias": torch.zeros(2, device="meta")}, "quantised or empty"),
        ({f"mlp_extractor__policy_net__{'9' * 5_000}__weight": torch.ones(2)}, "not an MLP's"),
        ({"mlp_extractor__policy_net__0__scale": torch.ones(2)}, r"policy_net\.0\.scale: not"),
    ],
)
def test_layers_that_are_no_mlp_are_refused(changes, message, tmp_path):
    path = rewritten("ppo", tmp_path / "model.zip", policy_pth=saved(weights(**changes)))
    with pytest.raises(ConfigError, match=message):
        teacher(path, CARTPOLE)


@pytest.mark.filterwarnings("ignore:.*(nested tensors|CSR).*:UserWarning")
def test_nested_and_compressed_tensors_are_refused(tmp_path):
    nested = torch.nested.nested_tensor([torch.ones(2), torch.ones(3)])
    for tensor in (nested, torch.eye(2).to_sparse_csr()):
        content = saved(weights(action_net__weight=tensor))
        with pytest.raises(ConfigError, match=r"cannot be read as a model of Stable-Baselines3"):
            teacher(rewritten("ppo", tmp_path / "model.zip", policy_pth=content), CARTPOLE)


def test_a_model_for_another_kind_of_action_is_refused():
    with pytest.raises(ConfigError, match="takes a Box"):
        teacher(str(MODELS / "ppo.zip"), REACH)
    with pytest.raises(ConfigError, match="takes a Discrete"):
        teacher(str(MODELS / "sac.zip"), CARTPOLE)


def test_a_file_that_is_no_model_is_refused_in_one_line(tmp_path):
    text = tmp_path / "text.zip"
    text.write_text("no zip")
    cut = tmp_path / "cut.zip"
    cut.write_bytes((MODELS / "ppo.zip").read_bytes()[:3_000])
    for path in (text, cut):
        with pytest.raises(ConfigError, match="cannot be read as a model of Stable-Baselines3"):
            teacher(str(path), CARTPOLE)
    for change, message in (
        ({"data": None}, "it has no data"),
        ({"data": None, "policy_pth": None}, r"no data and no policy\.pth"),
        ({"data": b"{"}, "data is no JSON"),
        ({"data": b"[" * 100_000}, "data is no JSON"),
        ({"data": b"[]"}, "data is no table"),
        ({"policy_pth": saved([1])}, "no state dict"),
        ({"policy_pth": saved({"a": 1})}, "no state dict"),
        ({"policy_pth": b"cut"}, "format of torch before"),
    ):
        with pytest.raises(ConfigError, match=message):
            teacher(rewritten("ppo", tmp_path / "part.zip", **change), CARTPOLE)
    with pytest.raises(ConfigError, match="there is no teacher at"):
        teacher(str(tmp_path / "none.zip"), CARTPOLE)
    with pytest.raises(ConfigError, match="leave teacher_units out"):
        teacher(str(MODELS / "sac.zip"), REACH, units="scaled")


def test_names_in_an_archive_that_are_no_text_are_refused(tmp_path):
    raw = (MODELS / "ppo.zip").read_bytes()
    path = tmp_path / "a.zip"
    path.write_bytes(raw.replace(b"data", b"\xff\xfe\xfd\xfc"))
    with pytest.raises(ConfigError, match=r"no model of Stable-Baselines3|cannot be read"):
        teacher(str(path), CARTPOLE)
    inner = saved(state_of("ppo")).replace(b"data.pkl", b"\xff" * 8)
    with pytest.raises(ConfigError, match="cannot be read"):
        teacher(rewritten("ppo", tmp_path / "b.zip", policy_pth=inner), CARTPOLE)
