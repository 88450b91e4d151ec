import subprocess
import sys
from typing import ClassVar

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium import spaces

from spikedeploy import envs
from spikedeploy.envs.foreign import AdaptedEnv
from spikedeploy.envs.repeats import check_repeats
from spikedeploy.envs.rollout import rollout
from spikedeploy.jobs import Serial, _leave
from spikedeploy.runtime.errors import EnvError
from spikedeploy.trainers.distill.teacher import OwnSpaces
from tests import own_env
from tests.paths import ROOT

REACH = "tests.own_env:Reach"


class Middle:
    """A controller that puts out the same at every step."""

    def __init__(self, action=(0.0, 0.0)):
        self.action = np.asarray(action)

    def reset(self, seed):
        pass

    def act(self, observation):
        return self.action


def test_a_registered_id_is_an_environment_with_random_as_its_only_built_in():
    spec = envs.spec("CartPole-v1")
    assert (spec.short, spec.id, spec.foreign) == ("CartPole-v1", "CartPole-v1", True)
    assert spec.target == "gymnasium.envs.classic_control.cartpole:CartPoleEnv"
    assert spec.controls == ("random",)
    assert not any(entry.foreign for entry in envs.ENVS.values())


def test_naming_imports_nothing_and_making_imports_what_was_named():
    code = """
import sys
from typing import ClassVar
from spikedeploy import envs
envs.spec("tests.own_env:Reach"), envs.spec("HalfCheetah-v5")
assert not {"tests.own_env", "mujoco"} & set(sys.modules)
envs.make("tests.own_env:Reach")
assert "tests.own_env" in sys.modules and "mujoco" not in sys.modules
"""
    subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=True)


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("cartpole-v1", "did you mean 'CartPole-v1'"),
        ("hexapd", "did you mean 'hexapod'"),
        ("xyzzy", "known: hexapod, .*module:Class"),
    ],
)
def test_an_unknown_name_is_refused_with_the_nearest(name, said):
    with pytest.raises(EnvError, match=f"unknown environment '{name}'; {said}"):
        envs.spec(name)


@pytest.mark.parametrize(
    ("name", "options", "said"),
    [
        ("nosuch_module:Env", {}, "there is no module nosuch_module"),
        ("nosuch.py:Env", {}, "leave .py out: nosuch:Env"),
        ("tests.own_env:Reech", {}, "has no 'Reech'; did you mean 'Reach'"),
        ("tests.own_env:np", {}, "np is no gymnasium.Env"),
        ("tests.own_env:OwnLevels-v9", {}, "registers no OwnLevels-v9"),
        (REACH, {"stebs": 3}, "has no option 'stebs'"),
        ("tests.own_env:refused", {}, "needs 'space' and 'kind': give each with --set"),
        (REACH, {"disturb": ["payload:1"]}, "has no .payload.; it has noise, bias"),
        (
            "tests.own_env:Levels",
            {"disturb": ["bias:1"]},
            "one of 3 levels, in which there is neither",
        ),
        ("hexapod", {"success": "fall"}, "hexapod defines success itself"),
    ],
)
def test_what_cannot_be_made_is_refused_with_a_sentence(name, options, said):
    with pytest.raises(EnvError, match=said):
        envs.make(name, **options)


def test_a_target_is_found_in_the_current_folder(tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "path", [path for path in sys.path if path not in ("", str(tmp_path))])
    monkeypatch.chdir(tmp_path)
    (tmp_path / "only_here.py").write_text("from tests.own_env import short as make_it\n")
    assert isinstance(envs.make("only_here:make_it"), AdaptedEnv)
    (tmp_path / "lacking.py").write_text("import nosuch_library\n")
    with pytest.raises(EnvError, match="importing lacking needs nosuch_library: install it"):
        envs.make("lacking:Env")


def test_actions_are_scaled_to_odd_bounds_and_observations_are_flat():
    env = envs.make(REACH)
    assert env.action_space == spaces.Box(-1.0, 1.0, (2,), np.float64)
    observation, info = env.reset(seed=3)
    assert (observation.shape, observation.dtype) == ((4,), np.float64)
    assert observation[1] == 100.0  # unscaled: policies have a normaliser
    assert info == {"valves": 2}
    for action in ([-1.0, -1.0], [1.0, 1.0], [0.0, 0.5], [-7.0, 3.0]):
        env.step(np.array(action))
    given = np.array(env.inner.unwrapped._given)[..., 0]
    expected = [[-0.3, 5.0], [0.1, 9.0], [-0.1, 8.0], [-0.3, 9.0]]
    np.testing.assert_allclose(given, np.array(expected, np.float32))


def test_levels_are_one_hot_and_choices_count_from_zero():
    env = envs.make("tests.own_env:OwnLevels-v3")
    assert env.action_space == spaces.Discrete(4)
    observation, _ = env.reset(seed=0)
    total = 0.0
    for _ in range(5):
        assert sorted(observation) == [0.0, 0.0, 1.0]
        observation, reward, terminated, _, info = env.step(int(np.argmax(observation)))
        total += reward
        assert info["success"] is (total >= 2.0)  # the registered threshold
    assert (total, terminated) == (5.0, True)


@pytest.mark.parametrize(
    ("kind", "space", "said"),
    [
        ("observation", spaces.Dict({"a": spaces.Discrete(2)}), "a Dict.*FlattenObservation"),
        ("observation", spaces.Box(0, 255, (8, 8, 3), np.uint8), r"pictures \(8, 8, 3\)"),
        ("action", spaces.MultiDiscrete([2, 3]), "a MultiDiscrete.*ActionWrapper"),
        ("action", spaces.MultiBinary(3), "a MultiBinary"),
        ("action", spaces.Box(np.array([0.0, -np.inf]), 1.0, (2,), np.float64), r"actions \[1\]"),
    ],
)
def test_other_spaces_are_refused_by_name_with_the_remedy(kind, space, said):
    with pytest.raises(EnvError, match=f"tests.own_env:refused.*{said}"):
        envs.make("tests.own_env:refused", kind=kind, space=space)


def test_success_is_the_key_that_is_named_or_else_unknown():
    played = rollout(envs.make(REACH, success="close"), Middle(), seed=1)
    assert played.success is bool(played.info["close"][-1])
    assert np.isnan(played.info["close"][0])
    assert played.options == {"success": "close"}
    assert rollout(envs.make(REACH), Middle(), seed=1).success is None
    with pytest.raises(EnvError, match=r"--success nose.*it has error, who, terms, close"):
        rollout(envs.make(REACH, success="nose"), Middle(), seed=1)


def test_is_success_of_other_libraries_is_success_where_that_is_absent(monkeypatch):
    class Told(own_env.Reach):
        said: ClassVar = {"is_success": np.float32(1.0)}

        def step(self, action):
            *found, info = super().step(action)
            return *found, {**info, **self.said}

    monkeypatch.setattr(own_env, "Told", Told, raising=False)
    env = envs.make("tests.own_env:Told")
    assert rollout(env, Middle(), seed=1).success is True
    Told.said = {"is_success": np.bool_(False)}
    assert rollout(env, Middle(), seed=1).success is False
    Told.said = {"is_success": True, "success": False}
    assert rollout(env, Middle(), seed=1).success is False
    assert "is_success" not in rollout(env, Middle(), seed=1).info  # one word for one thing
    assert env.remark == ""
    for said in (None, np.nan, np.ma.masked, "yes", np.array([True, False]), 0.3, -1, 2):
        Told.said = {"is_success": said}
        env = envs.make("tests.own_env:Told")
        assert rollout(env, Middle(), seed=1).success is None
        is_known = "so that success is not known: success is True or False" in env.remark
        assert is_known is not (said is None or said is np.nan or said is np.ma.masked)
    assert "is_success in the info of step 1 is 2 (int)" in check_repeats("tests.own_env:Told", {})
    Told.said = {"is_success": np.array([True]), "success": np.nan}
    assert rollout(env, Middle(), seed=1).success is True
    for said in ("yes", 0.3, -1, np.nan, [1, 1]):
        Told.said = {"is_success": said}
        with pytest.raises(EnvError, match=r"--success is_success: .* there, neither true nor fal"):
            rollout(envs.make("tests.own_env:Told", success="is_success"), Middle(), seed=1)
    Told.said = {"is_success": [True]}
    env = envs.make("tests.own_env:Told", success="is_success")
    assert rollout(env, Middle(), seed=1).success is True


def returning(monkeypatch, observation=None, **changed):
    """Reach whose `step` returns something else for reward, terminated, truncated or info."""

    class Odd(own_env.Reach):
        def step(self, action):
            seen, *found = super().step(action)
            given = dict(zip(("reward", "terminated", "truncated", "info"), found, strict=True))
            seen = seen if observation is None else observation(seen)
            return seen, *{**given, **changed}.values()

    monkeypatch.setattr(own_env, "Odd", Odd, raising=False)
    env = envs.make("tests.own_env:Odd")
    env.reset(seed=0)
    return env.step(np.zeros(2))


@pytest.mark.parametrize(
    "reward",
    [-2, np.float32(-2), np.array(-2.0), np.array([[-2]]), [-2.0], torch.tensor(-2.0),
     torch.tensor([-2.0], requires_grad=True)],
)  # fmt: skip
def test_a_reward_is_one_number_in_whatever_it_comes(monkeypatch, reward):
    found = returning(monkeypatch, reward=reward)[1]
    assert (type(found), found) == (float, -2.0)


@pytest.mark.parametrize(
    "reward",
    [None, np.nan, np.inf, "1.0", [1.0, 2.0], np.zeros(0), torch.zeros(2), {}, 1j, np.array("1"),
     np.ma.masked, np.ma.array(1.0, mask=True), [np.ma.array(1.0, mask=True)]],
)  # fmt: skip
def test_a_reward_that_is_no_number_is_refused_with_what_it_was(monkeypatch, reward):
    with pytest.raises(EnvError, match=r"Odd: reward of step 1 is .*: give one finite number"):
        returning(monkeypatch, reward=reward)


def _exits(*given, **options):
    sys.exit()


@pytest.mark.parametrize(
    ("method", "doing"),
    [("__init__", "its making"), ("reset", r"reset\(\)"), ("step", "step 1"),
     ("render", r"render\(\)"), ("close", r"close\(\)")],
)  # fmt: skip
def test_an_environment_that_ends_the_process_is_an_error(monkeypatch, method, doing):
    monkeypatch.setattr(own_env, "Ends", _old(**{method: _exits}), raising=False)

    def play():
        env = envs.make("tests.own_env:Ends", render_mode="rgb_array")
        rollout(env, Middle(), seed=0)
        env.render()
        env.close()

    with pytest.raises(EnvError, match=f"Ends ended the process in {doing}, with sys.exit"):
        Serial().in_order(lambda _: play(), [0], list)


def test_a_signal_that_ends_a_worker_in_a_step_still_ends_it(monkeypatch):
    env = _old(step=lambda self, action: _leave(15, None))
    monkeypatch.setattr(own_env, "Ends", env, raising=False)
    with pytest.raises(SystemExit, match="143"):
        rollout(envs.make("tests.own_env:Ends"), Middle(), seed=0)


def test_what_an_environment_prints_leaves_stdout_for_results(monkeypatch, capsys):
    def printing(name):
        def method(self, *given, **options):
            print(name)
            return getattr(own_env.Reach, name)(self, *given, **options)

        return method

    names = ("__init__", "reset", "step", "render", "close")
    monkeypatch.setattr(own_env, "Says", _old(**{n: printing(n) for n in names}), raising=False)
    env = envs.make("tests.own_env:Says", render_mode="rgb_array")
    rollout(env, Middle(), seed=0)
    env.render()
    env.close()
    found = capsys.readouterr()
    assert found.out == ""
    assert set(found.err.split()) == set(names)


@pytest.mark.parametrize("said", [True, 1, np.bool_(True), np.array([True]), torch.tensor(True)])
def test_an_end_is_true_or_false_in_whatever_it_comes(monkeypatch, said):
    assert returning(monkeypatch, terminated=said, truncated=False)[2:4] == (True, False)
    assert returning(monkeypatch, truncated=said)[2:4] == (False, True)


@pytest.mark.parametrize("said", [None, "False", 2, np.nan, np.zeros(2, bool), [], np.ma.masked])
@pytest.mark.parametrize("name", ["terminated", "truncated"])
def test_an_end_that_is_neither_is_refused(monkeypatch, name, said):
    with pytest.raises(EnvError, match=rf"Odd: {name} of step 1 is .*: give True or False"):
        returning(monkeypatch, **{name: said})


def test_no_info_is_an_empty_one_and_another_type_is_named(monkeypatch):
    assert returning(monkeypatch, info=None)[4] == {}
    with pytest.raises(EnvError, match=r"info is \[1\]"):
        returning(monkeypatch, info=[1])
    found = returning(monkeypatch, info={"a": np.array([2.0]), "b": torch.tensor(3), "c": [4]})[4]
    assert found == {"a": 2.0, "b": 3}
    assert returning(monkeypatch, info={"a": np.ma.array([2.0], mask=True)})[4] == {}


@pytest.mark.parametrize(
    "given",
    [lambda seen: seen.tolist(), tuple, torch.tensor, lambda seen: seen.astype(np.float16),
     lambda seen: seen[None]],
)  # fmt: skip
def test_an_observation_is_numbers_in_whatever_they_come(monkeypatch, given):
    found = returning(monkeypatch, given)[0]
    assert (found.dtype, found.shape) == (np.float64, (4,))
    np.testing.assert_allclose(found, returning(monkeypatch)[0], rtol=1e-3)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (lambda seen: seen.ravel(), r"has the shape \(4,\), and observation_space says \(2, 2\)"),
        (lambda seen: seen[:1], r"has the shape \(1, 2\)"),
        (lambda seen: [[1.0], [1.0, 2.0]], "give numbers of shape"),
        (lambda seen: {"a": seen}, r"\(dict\): give numbers"),
        (lambda seen: seen.astype(str), "give numbers"),
        (lambda seen: np.full((2, 2), None), "give numbers"),
        (lambda seen: np.ma.array(seen, mask=[[1, 0], [0, 0]]), "give numbers"),
        (lambda seen: list(np.ma.array(seen, mask=[[1, 0], [0, 0]])), "give numbers"),
        (lambda seen: np.array([[0.0, -np.inf], [np.nan, 0.0]]), r"has -inf, nan at \[1, 2\]"),
        (lambda seen: np.full((2, 2), 1e39), "1e.39.* no finite number of float32"),
    ],
)
def test_an_observation_that_is_none_is_refused(monkeypatch, given, said):
    with pytest.raises(EnvError, match=f"Odd: observation of step 1 .*{said}"):
        returning(monkeypatch, given)


@pytest.mark.parametrize("level", [4, 8, 5.5, None, [5, 6]])
def test_a_level_that_the_space_has_not_is_refused(monkeypatch, level):
    monkeypatch.setattr(own_env.Levels, "_level", lambda _: level)
    with pytest.raises(EnvError, match="observation of step 0 is "):
        envs.make("tests.own_env:Levels").reset(seed=0)


LARGE32, LARGE64 = float(np.finfo(np.float32).max), float(np.finfo(np.float64).max)


@pytest.mark.parametrize(
    ("low", "high", "kind"),
    [
        (-LARGE32, LARGE32, np.float32),
        (-LARGE64, LARGE64, np.float64),
        (0.0, 1e38, np.float32),
        (-1e10, 1.0, np.float32),
        (-(2**31), 2**31 - 1, np.int32),
        (-(2.0**23), 2.0**23 + 2, np.float64),
    ],
)
def test_bounds_so_wide_that_labels_vanish_are_none(low, high, kind):
    both = [np.array([-1, bound], kind) for bound in (low, high)]
    both[1][0] = 1
    space = spaces.Box(*both, (2,), kind)
    with pytest.raises(EnvError, match=r"actions \[1\] have no bounds.*2\^24 = 16,777,216"):
        envs.make("tests.own_env:refused", kind="action", space=space)


def test_wide_bounds_and_those_without_a_choice_are_met():
    space = spaces.Box(np.array([-(2.0**23), 0.5]), np.array([2.0**23, 0.5]), (2,), np.float64)
    made = envs.make("tests.own_env:refused", kind="action", space=space)
    np.testing.assert_array_equal(made._to_inner([1.0, 0.3]), [2.0**23, 0.5])
    own = OwnSpaces.within("own", made)
    one, other = own.labels("t", np.array([[0.3, 0.5], [-1.0, 0.5]]), 2, "own")
    assert one[0] != other[0]
    assert one[1] == other[1] == 0.0


def test_many_choices_are_refused():
    for kind in ("observation", "action"):
        with pytest.raises(EnvError, match="one of 10,000,000, and policies have a number for"):
            envs.make("tests.own_env:refused", kind=kind, space=spaces.Discrete(10**7))


@pytest.mark.parametrize("in_place", [True, False])
@pytest.mark.parametrize(("method", "when"), [("reset", r"reset\(\)"), ("step", "step 1")])
def test_spaces_that_change_are_refused(monkeypatch, in_place, method, when):
    class Grows(own_env.Reach):
        def __init__(self):
            super().__init__()
            self.action_space = spaces.Box(-1.0, 1.0, (2, 1), np.float32)

    def grow(self, *given, **options):
        if in_place:
            self.action_space.high[:] = 9.0
        else:
            self.action_space = spaces.Box(-1.0, 9.0, (2, 1), np.float32)
        return getattr(own_env.Reach, method)(self, *given, **options)

    setattr(Grows, method, grow)
    monkeypatch.setattr(own_env, "Grows", Grows, raising=False)
    with pytest.raises(EnvError, match=f"its spaces change in {when}"):
        rollout(envs.make("tests.own_env:Grows"), Middle(), seed=0)


@pytest.mark.parametrize("kind", ["NormalizeObservation", "NormalizeReward"])
def test_a_wrapper_that_goes_on_measuring_is_refused_unless_it_is_frozen(monkeypatch, kind):
    def wrapped(freeze=False):
        made = getattr(gymnasium.wrappers, kind)(own_env.Reach())
        made.update_running_mean = not freeze
        return gymnasium.wrappers.RecordEpisodeStatistics(made)

    monkeypatch.setattr(own_env, "wrapped", wrapped, raising=False)
    with pytest.raises(EnvError, match=f"wrapped: gymnasium's {kind} goes on measuring"):
        envs.make("tests.own_env:wrapped")
    assert check_repeats("tests.own_env:wrapped", {"freeze": True}) == ""


def _old(**methods):
    return type("Old", (own_env.Reach,), methods)


def _raises(self, action):
    one, two = (1, 2, 3)  # a bug of its own
    return one, two


OLD = {
    "four values": _old(step=lambda self, action: own_env.Reach.step(self, action)[:4]),
    "no info": _old(reset=lambda self, *, seed=None, options=None: np.zeros((2, 2))),
    "a vector of two": _old(reset=lambda self, *, seed=None, options=None: np.zeros(2)),
    "no seed": _old(reset=lambda self: np.zeros((2, 2))),
}


@pytest.mark.parametrize("options", [{}, {"max_episode_steps": 5}])
@pytest.mark.parametrize("old", OLD)
def test_an_environment_of_the_old_api_is_refused_in_a_sentence(old, options, monkeypatch):
    monkeypatch.setattr(own_env, "Old", OLD[old], raising=False)
    with pytest.raises(EnvError, match=r"tests.own_env:Old: (step|reset).*change it to that"):
        rollout(envs.make("tests.own_env:Old", **options), Middle(), seed=0)


def test_a_bug_of_an_environment_is_no_old_api(monkeypatch):
    monkeypatch.setattr(own_env, "Old", _old(step=_raises), raising=False)
    with pytest.raises(ValueError, match="too many values"):
        rollout(envs.make("tests.own_env:Old"), Middle(), seed=0)


@pytest.mark.parametrize(
    ("name", "period"), [("Pendulum-v1", 0.05), ("CartPole-v1", 0.02), (REACH, 0.025)]
)
def test_the_control_period_is_the_environments(name, period):
    found = envs.make(name).unwrapped.CONTROL_DT
    assert found == pytest.approx(period)


def test_an_episode_without_an_end_is_refused(monkeypatch):
    monkeypatch.setattr("spikedeploy.envs.foreign._LONGEST", 5)
    with pytest.raises(EnvError, match=r"did not end in 5 steps.*max_episode_steps"):
        rollout(envs.make(REACH), Middle(), seed=0)


def test_an_observation_that_is_not_finite_is_refused(monkeypatch):
    env = envs.make(REACH)
    monkeypatch.setattr(own_env.Reach, "_seen", lambda _: np.full((2, 2), np.nan))
    with pytest.raises(EnvError, match="observation of step 0"):
        env.reset(seed=0)


def walk(env, seed=3):
    """Observations of an episode of actions that are drawn."""
    rng, space = np.random.default_rng(seed), env.action_space
    seen, over = [env.reset(seed=seed)[0]], False
    while not over:
        drawn = rng.integers(2) if hasattr(space, "n") else rng.uniform(-1.0, 1.0, space.shape)
        observation, _, terminated, truncated, _ = env.step(drawn if np.ndim(drawn) else int(drawn))
        seen.append(observation)
        over = terminated or truncated
    return np.array(seen)


@pytest.mark.parametrize("name", ["CartPole-v1", "Pendulum-v1", REACH])
@pytest.mark.parametrize(
    "what", ["noise", "bias", "dropout", "delay", "command-delay", "command-loss"]
)
def test_what_is_observed_and_commanded_is_disturbed_in_any_environment(name, what):
    calm, first = walk(envs.make(name)), walk(envs.make(name, disturb=[f"{what}:3"]))
    again = walk(envs.make(name, disturb=[f"{what}:3"]))
    assert np.array_equal(first, again)
    assert np.array_equal(walk(envs.make(name, disturb=[f"{what}:0"])), calm)
    if name != REACH or not what.startswith("command"):  # which does not observe its valves
        assert first.shape != calm.shape or not np.array_equal(first, calm)


def test_noise_is_in_standard_deviations_under_random_actions():
    calm = walk(envs.make("Pendulum-v1"))  # 200 steps of each
    noisy = walk(envs.make("Pendulum-v1", disturb=["noise=0.5"]))
    apart = (noisy - calm).std(0)
    env = envs.make("Pendulum-v1")
    rng, seen = np.random.default_rng(5), []
    for seed in range(10):
        seen.append(env.reset(seed=seed)[0])
        seen += [env.step(rng.uniform(-1.0, 1.0, 1))[0] for _ in range(200)]
    np.testing.assert_allclose(apart, 0.5 * np.std(seen, 0), rtol=0.25)


def test_one_of_several_levels_is_lost_as_a_whole():
    seen = walk(envs.make("tests.own_env:Levels", disturb=["dropout:3"]))
    assert (seen.sum(1) == 1.0).all()
