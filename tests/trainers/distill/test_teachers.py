"""Teachers of others: functions, ONNX files, models of Stable-Baselines3.

tests/golden/sb3 was recorded by lab/peers/sb3_models.py of commit 548e02fb.
"""

import base64
import io
import json
import pickle
import sys
import zipfile

import numpy as np
import onnx
import pytest
import torch
from gymnasium.spaces import Box
from onnx import TensorProto, helper, numpy_helper

from spikedeploy import envs
from spikedeploy.exporters.to_onnx import to_onnx
from spikedeploy.runtime.errors import ArtifactError, ConfigError, EnvError
from spikedeploy.runtime.metadata import Provenance
from spikedeploy.trainers.config import EnvConfig, ValidationConfig
from spikedeploy.trainers.distill import sb3
from spikedeploy.trainers.distill.teacher import OwnSpaces
from spikedeploy.trainers.distill.teachers import score, teacher
from spikedeploy.trainers.policies import MlpPolicy
from tests.paths import ROOT

REACH, LEVELS, CARTPOLE = "tests.own_env:Reach", "tests.own_env:OwnLevels-v3", "CartPole-v1"
BEST = {"reach": None, "reach_scaled": "scaled", "reach_all": None}
FLOAT, INT = TensorProto.FLOAT, TensorProto.INT64


def network(path, inputs, outputs, nodes=None, weight=None, kind=FLOAT, found=FLOAT):
    """An ONNX file as other tools write them; by default a linear map of the first input."""
    weight = np.eye(4, 2) if weight is None else weight
    ends = [helper.make_tensor_value_info(name, kind, shape) for name, shape in inputs]
    exits = [helper.make_tensor_value_info(name, found, shape) for name, shape in outputs]
    nodes = nodes or [helper.make_node("MatMul", [inputs[0][0], "weight"], [outputs[0][0]])]
    held = [numpy_helper.from_array(weight.astype(np.float32), "weight")]
    graph = helper.make_graph(nodes, "policy", ends, exits, held)
    made = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 13)], ir_version=8)
    onnx.save(made, path)
    return str(path)


@pytest.mark.parametrize("name", BEST)
def test_a_function_sees_and_acts_in_the_units_of_its_environment(name):
    found = teacher(f"tests.own_teachers:{name}", REACH, units=BEST[name])
    assert (found.observations, found.actions) == (4, 2)
    batch = np.array([[0.25, 100.0, -2.5, 0.0], [1.0, 100.0, -3.0, 0.0]])
    np.testing.assert_allclose(found.act_all(batch), [[-0.5, 0.0], [1.0, -1.0]], atol=1e-6)
    earned = score(found, EnvConfig(name=REACH), ValidationConfig(episodes=2))
    assert earned == pytest.approx(0.0, abs=1e-4)


def test_the_expert_of_an_environment_acts_in_its_units_where_it_runs():
    found = teacher("expert", REACH)
    earned = score(found, EnvConfig(name=REACH), ValidationConfig(episodes=2))
    assert earned == pytest.approx(0.0, abs=1e-4)
    with pytest.raises(ConfigError, match="not on observations"):
        found.act_all(np.zeros((1, 4)))


@pytest.mark.parametrize("name", ["level", "level_logits"])
def test_a_function_chooses_as_its_environment_counts_or_gives_logits(name):
    found = teacher(f"tests.own_teachers:{name}", LEVELS)
    assert found.act_all(np.eye(3)).argmax(-1).tolist() == [0, 1, 2]
    assert score(found, EnvConfig(name=LEVELS), ValidationConfig(episodes=2)) == 5.0


@pytest.mark.parametrize(
    ("name", "env", "message"),
    [
        ("too_many", REACH, r"gives 7 actions; tests\.own_env:Reach takes 2"),
        ("too_many", LEVELS, r"give its number, from -1 to 2, or 4 logits"),
        ("no_choice", LEVELS, r"gave \[3\.0\].* takes one of 4 actions"),
        ("between", LEVELS, r"gave \[0\.5\]"),
        ("nothing", REACH, "gave no finite numbers"),
        ("lost", REACH, "gave no finite numbers"),
        ("masked", REACH, "gave no finite numbers"),
        ("empty", LEVELS, "gave no finite numbers"),
        ("leaves", REACH, r"own_teachers:leaves ended the process in a call"),
    ],
)
def test_what_a_function_gives_is_checked(name, env, message):
    found = teacher(f"tests.own_teachers:{name}", env)
    seen = np.eye(3)[:1] if env == LEVELS else np.zeros((1, 4))
    with pytest.raises((ConfigError, EnvError), match=message):
        found.act_all(seen)


def test_nothing_is_imported_but_what_was_named(tmp_path, monkeypatch):
    (tmp_path / "my_teacher.py").write_text("def act(observation):\n    return 1\n")
    (tmp_path / "beside.py").write_text("")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    found = teacher("my_teacher:act", CARTPOLE)
    assert found.act_all(np.zeros((3, 4))).argmax(-1).tolist() == [1, 1, 1]
    assert "beside" not in sys.modules
    del sys.modules["my_teacher"]
    with pytest.raises(EnvError, match=r"no module gone, .*a teacher is module:function"):
        teacher("gone:act", CARTPOLE)
    with pytest.raises(EnvError, match=r"has no 'reech'; did you mean 'reach'\?"):
        teacher("tests.own_teachers:reech", REACH)
    with pytest.raises(ConfigError, match="NUMBER is no function of an observation, but 3"):
        teacher("tests.own_teachers:NUMBER", REACH)
    with pytest.raises(ConfigError, match=r"has a reset\(\), .* not imitated"):
        teacher("tests.own_teachers:remembers", REACH)


# as rsl_rl exports: one observation, "obs" to "actions"; and as others do
FORMS = {
    "rsl_rl": ([("obs", [1, 4])], [("actions", [1, 2])]),
    "batch": ([("input.1", ["n", 4])], [("17", ["n", 2])]),
    "unknown sizes": ([("x", ["n", "k"])], [("y", ["n", "m"])]),
    "no batch": ([("x", [4])], [("y", [2])]),
}


@pytest.mark.parametrize("form", FORMS)
def test_an_onnx_file_of_others_acts_in_the_units_of_the_environment(form, tmp_path):
    weight = np.array([[0.4, 0.0], [0.0, 0.08], [0.0, 0.0], [0.0, 0.0]])
    path = network(tmp_path / "policy.onnx", *FORMS[form], weight=weight)
    found = teacher(path, REACH)
    batch = np.array([[-0.75, 100.0, 7.0, 7.0], [0.0, 62.5, 0.0, 0.0], [9.0, 200.0, 0.0, 0.0]])
    # own actions (-0.3, 8), (0, 5) and (3.6, 16) of bounds [-0.3, 0.1] and [5, 9]
    wanted = [[-1.0, 0.5], [0.5, -1.0], [1.0, 1.0]]
    np.testing.assert_allclose(found.act_all(batch), wanted, atol=1e-5)
    scaled = teacher(path, REACH, units="scaled").act_all(batch / 100.0)
    np.testing.assert_allclose(scaled, np.clip(batch / 100.0 @ weight, -1, 1), atol=1e-6)


def test_an_export_of_rsl_rl_acts_as_its_policy_did():
    folder = (
        ROOT / "tests/golden/rsl_rl"
    )  # recorded by lab/peers/rsl_rl_policy.py of commit 548e02fb
    with np.load(folder / "actions.npz") as file:
        observation, action = file["observation"].astype(np.float64), file["action"]
    found = teacher(str(folder / "policy.onnx"), REACH).act_all(observation)
    low, high = np.array([-0.3, 5.0]), np.array([0.1, 9.0])
    own = low + (found + 1.0) / 2.0 * (high - low)
    np.testing.assert_allclose(own, np.clip(action, low, high), atol=1e-5)
    assert 0.1 < (np.abs(found) < 1.0).mean() < 0.95


def test_an_onnx_file_of_others_may_observe_in_the_environments_own_shape(tmp_path):
    flat = helper.make_node("Flatten", ["obs"], ["flat"])
    mapped = helper.make_node("MatMul", ["flat", "weight"], ["actions"])
    ends = [("obs", ["n", 2, 2])], [("actions", ["n", 2])]
    found = teacher(network(tmp_path / "p.onnx", *ends, nodes=[flat, mapped]), REACH)
    assert found.observations == 4
    assert found.act_all(np.array([[0.1, 7.0, 0.0, 0.0]]))[0] == pytest.approx([1.0, 0.0])


def test_an_onnx_file_of_others_chooses_by_number_or_by_logits(tmp_path):
    ends = [("obs", ["n", 4])], [("logits", ["n", 2])]
    logits = teacher(network(tmp_path / "logits.onnx", *ends), CARTPOLE)
    seen = np.array([[0.3, 0.1, 0.0, 0.0], [0.1, 0.3, 0.0, 0.0]])
    np.testing.assert_allclose(logits.act_all(seen), seen[:, :2], atol=1e-6)
    nodes = [
        helper.make_node("MatMul", ["obs", "weight"], ["l"]),
        helper.make_node("ArgMax", ["l"], ["action"], axis=1, keepdims=0),
    ]
    ends = [("obs", ["n", 4])], [("action", ["n"])]
    path = network(tmp_path / "choice.onnx", *ends, nodes=nodes, found=INT)
    assert teacher(path, CARTPOLE).act_all(seen).argmax(-1).tolist() == [0, 1]


REFUSED = {
    "recurrent": (
        ([("obs", [1, 4]), ("h_in", [1, 8])], [("actions", [1, 2])], {}),
        r"has 2 inputs \(obs, h_in\).* recurrent policies",
    ),
    "outputs": (
        ([("obs", [1, 4])], [("mean", [1, 2]), ("std", [1, 2])], {}),
        r"has 2 outputs \(mean, std\)",
    ),
    "many": (([("obs", [8, 4])], [("actions", [8, 2])], {}), "takes 8 observations at once"),
    "integers": (
        ([("obs", [1, 4])], [("actions", [1, 4])], {"kind": INT, "found": INT}),
        r"takes tensor\(int64\)",
    ),
    "actions": (
        ([("obs", [1, 4])], [("actions", [1, 3])], {"weight": np.eye(4, 3)}),
        "gives 3 actions",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_an_onnx_file_that_is_no_map_from_observation_to_action_is_refused(case, tmp_path):
    (inputs, outputs, more), message = REFUSED[case]
    nodes = None
    if case == "outputs":
        ends = ("mean", "std")
        nodes = [helper.make_node("MatMul", ["obs", "weight"], [name]) for name in ends]
    if case == "integers":
        nodes = [helper.make_node("Identity", ["obs"], ["actions"])]
    path = network(tmp_path / "policy.onnx", inputs, outputs, nodes=nodes, **more)
    with pytest.raises(ConfigError, match=message):
        teacher(path, REACH)


def test_the_action_of_several_outputs_is_known_by_its_name(tmp_path):
    nodes = [helper.make_node("MatMul", ["obs", "weight"], [name]) for name in ("value", "actions")]
    outputs = [("value", [1, 2]), ("actions", [1, 2])]
    path = network(tmp_path / "policy.onnx", [("obs", [1, 4])], outputs, nodes=nodes)
    assert teacher(path, REACH).actions == 2


@pytest.mark.parametrize("where", ["metadata", "input"])
def test_an_onnx_file_with_names_or_metadata_that_are_no_text_is_refused(where, tmp_path):
    path = tmp_path / "theirs.onnx"
    network(path, [("XXXX" if where == "input" else "obs", ["B", 4])], [("action", ["B", 2])])
    if where == "metadata":
        made = onnx.load(path)
        helper.set_model_props(made, {"env": "XXXX"})
        onnx.save(made, path)
    path.write_bytes(path.read_bytes().replace(b"XXXX", b"\xff\xfe\xff\xfe"))
    with pytest.raises(ArtifactError, match=r"theirs\.onnx.* no text"):
        teacher(str(path), REACH)


def test_a_teacher_of_ours_acts_in_scaled_units_already(tmp_path):
    policy = MlpPolicy(4, 2, hidden=()).eval()
    path = to_onnx(policy, Provenance(REACH), tmp_path / "ours.onnx")
    seen = np.random.default_rng(0).normal(size=(5, 4))
    found = teacher(str(path), REACH).act_all(seen)
    assert (np.abs(found) < 1).all()
    env = envs.make(REACH)
    env.reset(seed=0)
    env.step(found[0])  # the environment checks that it is in its box
    with pytest.raises(ConfigError, match="leave teacher_units out"):
        teacher(str(path), REACH, units="own")


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


@pytest.mark.parametrize(
    ("name", "value"), [("clip_mean", True), ("clip_mean", "2"), ("clip_mean", -1.0)]
)
def test_a_clip_of_the_mean_that_is_no_number_is_refused(name, value, tmp_path):
    path = rewritten("sac-gsde", tmp_path / "m.zip", setting("policy_kwargs", name, value=value))
    with pytest.raises(ConfigError, match=f"its setting {name} is .*no positive number"):
        teacher(path, REACH)


def test_a_renormalisation_that_does_not_fit_is_refused(tmp_path):
    state = state_of("crossq")
    state["actor.latent_pi.3.ra_var"] = torch.ones(5)
    path = rewritten("crossq", tmp_path / "m.zip", policy_pth=saved(state))
    with pytest.raises(ConfigError, match=r"renormalisation actor\.latent_pi\.3 does not fit"):
        teacher(path, REACH)


@pytest.mark.parametrize("name", ["ppo", "dqn"])
def test_discrete_choices_equal_those_of_predict(name):
    observation, expected = recorded(name)
    found = teacher(str(MODELS / f"{name}.zip"), CARTPOLE)
    assert (found.observations, found.actions) == (4, 2)
    np.testing.assert_array_equal(found.act_all(observation).argmax(-1), expected)
    assert 0.1 < expected.mean() < 0.9


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
        teacher(bomb, CARTPOLE)


def setting(*keys, value):
    def change(data):
        for key in keys[:-1]:
            data = data[key]
        data[keys[-1]] = value

    return change


RECURRENT = "sb3_contrib.common.recurrent.policies"
UNFIT = {
    "quantiles": (
        "dqn",
        setting("policy_class", "__module__", value="sb3_contrib.qrdqn.policies"),
        "it is QR-DQN, whose network puts out quantiles",
    ),
    "search": (
        "a2c",
        setting("policy_class", "__module__", value="sb3_contrib.ars.policies"),
        "it is ARS",
    ),
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


@pytest.mark.parametrize("case", UNFIT)
def test_a_policy_that_is_no_mlp_of_the_observation_is_refused_with_the_remedy(case, tmp_path):
    name, change, message = UNFIT[case]
    path = rewritten(name, tmp_path / "model.zip", change)
    with pytest.raises(ConfigError, match=message) as refusal:
        teacher(path, REACH if name in ("a2c", "sac") else CARTPOLE)
    assert "Export the policy to ONNX, or name a function of yours" in str(refusal.value)


@pytest.mark.parametrize(
    ("module", "said", "remedy"),
    [
        (RECURRENT, "is recurrent", "Train one without memory"),
        ("sb3_contrib.common.maskable.policies", "it is MaskablePPO", "asks for the mask"),
    ],
)
def test_a_policy_that_needs_more_than_an_observation_says_what_would_help(
    module, said, remedy, tmp_path
):
    change = setting("policy_class", "__module__", value=module)
    with pytest.raises(ConfigError, match=f"{said}.*{remedy}"):
        teacher(rewritten("ppo", tmp_path / "model.zip", change), CARTPOLE)


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
    named = tmp_path / "named.zip"
    named.write_bytes((MODELS / "ppo.zip").read_bytes().replace(b"data", b"\xff\xfe\xfd\xfc"))
    for path in (text, cut, named):
        with pytest.raises(ConfigError, match="cannot be read as a model of Stable-Baselines3"):
            teacher(str(path), CARTPOLE)
    unnamed = saved(state_of("ppo")).replace(b"data.pkl", b"\xff" * 8)
    for change, message in (
        ({"data": None}, "it has no data"),
        ({"data": None, "policy_pth": None}, r"no data and no policy\.pth"),
        ({"data": b"{"}, "data is no JSON"),
        ({"data": b"[" * 100_000}, "data is no JSON"),
        ({"data": b"[]"}, "data is no table"),
        ({"policy_pth": saved([1])}, "no state dict"),
        ({"policy_pth": saved({"a": 1})}, "no state dict"),
        ({"policy_pth": b"cut"}, "format of torch before"),
        ({"policy_pth": unnamed}, "cannot be read"),
    ):
        with pytest.raises(ConfigError, match=message):
            teacher(rewritten("ppo", tmp_path / "part.zip", **change), CARTPOLE)
    with pytest.raises(ConfigError, match="there is no teacher at"):
        teacher(str(tmp_path / "none.zip"), CARTPOLE)
    with pytest.raises(ConfigError, match="leave teacher_units out"):
        teacher(str(MODELS / "sac.zip"), REACH, units="scaled")
