"""The command of all experiments: a design of its options, or a sentence."""

import pytest

from lab.experiments.runner import design_class
from spikedeploy.runtime.errors import SpikedeployError


@pytest.mark.parametrize(
    ("name", "options", "sentence"),
    [
        ("kart", {"levels": 3}, "the experiment kart has no levels"),
        ("pareto", {"env": "hexapod", "finishes": 3}, "the experiment pareto has no finishes"),
        ("pareto", {}, "needs an environment: hexapod, hexapod-command"),
        ("pareto", {"env": "hexapot"}, "no environment 'hexapot'"),
        ("pareto", {"env": "kart-grid", "chip": "nope"}, "no chip 'nope'"),
        ("gymnasium", {"finishes": 3}, "the experiment gymnasium has no finishes"),
        ("gymnasium", {"env": "Walker2d-v5"}, "no task 'Walker2d-v5'; known: CartPole-v1"),
        ("gymnasium", {"set": ("budget=3",)}, r"--set budget=3: say of which trainings"),
        ("lineup", {"levels": 3}, "the experiment lineup has no levels"),
        ("lineup", {"env": "kart-grid"}, "no policy that was distilled is shipped for 'kart-grid'"),
        ("robustness", {"env": "kart-grid", "seeds": 2}, "robustness has no seeds"),
        ("robustness", {}, "needs an environment"),
        ("robustness", {"env": "moon"}, "no environment 'moon'"),
        ("robustness", {"env": "CartPole-v1"}, "CartPole-v1 are shipped: name yours"),
        ("robustness", {"env": "CartPole-v1", "policies": ["random"]}, "random is built in"),
        ("robustness", {"env": "CartPole-v1", "policies": ["kart-grid/snn"]}, "was made for"),
        (
            "robustness",
            {"env": "kart-grid", "policies": ["kart-grid/snn,kart-grid/snn"]},
            "two are called snn",
        ),
        ("robustness", {"env": "CartPole-v1", "policies": ["nowhere"]}, "no policy at 'nowhere'"),
        ("cart", {}, "unknown experiment 'cart'; known: kart"),
    ],
)
def test_an_option_that_does_not_fit_is_refused_in_a_sentence(name, options, sentence):
    with pytest.raises(SpikedeployError, match=sentence):
        design_class(name).of(options)


@pytest.mark.parametrize(
    ("name", "options", "field", "value"),
    [
        ("kart", {}, "runs", "runs/experiment-kart"),
        ("kart", {"quick": True}, "runs", "runs/kart-quick"),
        ("kart", {"quick": True}, "seeds", 1),
        ("kart", {"controls": 0}, "controls", 0),
        ("pareto", {"env": "kart-grid"}, "episodes", 300),
        ("pareto", {"env": "hexapod"}, "episodes", 100),
        ("pareto", {"env": "kart-grid", "episodes": 7}, "episodes", 7),
        ("gymnasium", {"env": "Pendulum-v1"}, "tasks", ("Pendulum-v1",)),
        ("gymnasium", {"quick": True}, "runs", "runs/gymnasium-quick"),
        ("robustness", {"env": "kart-grid", "quick": True}, "episodes", 2),
        ("robustness", {"env": "kart-grid", "quick": True, "episodes": 4}, "episodes", 4),
    ],
)
def test_sizes_are_those_of_the_experiment_unless_they_are_given(name, options, field, value):
    assert getattr(design_class(name).of(options), field) == value
