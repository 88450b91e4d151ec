"""Teachers of others: functions, and ONNX files."""

import pickle
import sys

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper

from spikedeploy import envs
from spikedeploy.exporters.to_onnx import to_onnx
from spikedeploy.runtime.errors import ArtifactError, ConfigError, EnvError
from spikedeploy.runtime.metadata import Provenance
from spikedeploy.trainers.config import EnvConfig, ValidationConfig
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


def test_a_pickle_is_not_read(tmp_path):
    (tmp_path / "vecnormalize.pkl").write_bytes(pickle.dumps(1))
    with pytest.raises(ConfigError, match=r"is a pickle, which could run code .*own-teacher\.md"):
        teacher(str(tmp_path / "vecnormalize.pkl"), CARTPOLE)
