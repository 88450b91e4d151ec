"""Models of others are taken as they are: exported, and trained through a chip."""

import numpy as np
import pytest

torch = pytest.importorskip("torch")

import spikedeploy as sd  # noqa: E402
from tests.trainers import public_models  # noqa: E402

pytestmark = pytest.mark.filterwarnings("ignore:.*the nearest that it does")
T, B = 10, 3
# the model, the shape of a timestep of a sample, and the weights before spikes, made larger
MODELS = {
    "snntorch-tutorial-5": (lambda: public_models.tutorial_5(12, 20, 5, T), (12,), 4),
    "snntorch-recurrent": (lambda: public_models.tutorial_regression_2(12, 20, T), (12,), 4),
    "snntorch-primate-reaching": (lambda: public_models.primate_reaching(12, 20), (12,), 4),
    "snntorch-speech-commands": (lambda: public_models.speech_commands(12, 20), (12,), 4),
    "snntorch-prosthesis": (public_models.prosthesis, (8,), 4),
    "norse-poker-dvs": (lambda: public_models.poker_dvs((2, 5, 5), 20), (2, 5, 5), 1),
    "norse-eeg": (public_models.eeg_classifier, (8,), 20),
}


def model(name):
    """The model, and spikes (T, B, *shape) for it, the same in all timesteps if it repeats them."""
    kind = name.partition("-")[0]
    reason = f"{kind} is not installed; ./spike test --peers runs its models"
    pytest.importorskip({"norse": "norse.torch"}.get(kind, kind), reason=reason)
    make, shape, gain = MODELS[name]
    torch.manual_seed(0)
    net = make().eval()
    with torch.no_grad():
        for parameter in net.parameters():
            if parameter.ndim == 2:
                parameter.mul_(gain)
    x = (torch.rand(T, B, *shape) < 0.4).float()
    return net, x[:1].expand_as(x) if name in REPEATED else x, shape


REPEATED = ("snntorch-tutorial-5", "snntorch-recurrent")
OF_ONE_TIMESTEP = ("snntorch-speech-commands",)


def own_output(name, net, x):
    if name in OF_ONE_TIMESTEP:
        return torch.stack([net(row)[0] for row in x])
    found = net(x[0] if name in REPEATED else x)
    return found[0] if isinstance(found, tuple) else found


@pytest.mark.parametrize("name", MODELS)
def test_a_model_of_others_is_exported_as_it_is(name, tmp_path):
    net, x, shape = model(name)
    run = sd.export(net, tmp_path / "net.nir", shape).run(x.numpy().swapaxes(0, 1).astype(np.uint8))
    found = run.outputs["output"].swapaxes(0, 1)
    expected = own_output(name, net, x).detach().numpy()
    assert 0.01 < np.abs(expected).mean() < 5
    np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("name", MODELS)
def test_a_model_of_others_is_trained_through_a_chip(name):
    net, x, shape = model(name)
    module = sd.on_chip(net, "loihi1", shape)
    optimiser = torch.optim.Adam(net.parameters(), 0.01)
    before = [p.detach().clone() for p in net.parameters()]
    (module(x).mean(0) - 0.5).square().sum().backward()
    optimiser.step()
    after = list(net.parameters())
    moved = [not torch.equal(p, old) for p, old in zip(after, before, strict=True)]
    assert sum(moved) > len(moved) / 2
    assert module(x).isfinite().all()


def test_recordings_of_a_model_hold_nothing_of_the_example():
    net, _, shape = model("snntorch-primate-reaching")
    sd.on_chip(net, "loihi1", shape)
    assert not net.inputs
    assert not net.spikes_1
