"""Neurons of Norse, sinabs and SpikingJelly: a file of ours computes what their library does.

`./spike test --peers` runs this in an environment of each; the library of a case begins its name.
"""

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from torch import nn  # noqa: E402

import spikedeploy as sd  # noqa: E402

pytestmark = pytest.mark.filterwarnings("ignore")
NEURONS_ARE_IN = {
    "norse": "norse.torch",
    "sinabs": "sinabs.layers",
    "spikingjelly": "spikingjelly.activation_based.neuron",
}


def library(name):
    """The library that a case begins with; skips where it is not installed."""
    kind = name.partition("-")[0]
    reason = f"{kind} is not installed; ./spike test --peers compares with it"
    return pytest.importorskip(NEURONS_ARE_IN[kind], reason=reason, exc_type=ImportError)


def norse(kind, **fields):
    import norse.torch as own
    from norse.torch.functional import reset

    made = {name: torch.as_tensor(value) for name, value in fields.items() if name != "subtract"}
    if "subtract" in fields:
        made["reset_method"] = reset.reset_subtract
    parameters = kind.replace("Recurrent", "").replace("Linear", "")
    parameters = getattr(own, parameters.removesuffix("Cell") + "Parameters")(**made)
    sizes = (6, 6) if kind in ("LIFRecurrentCell", "LIFRecurrent", "LILinearCell") else ()
    return getattr(own, kind)(*sizes, p=parameters)


def sinabs(kind, spikes="MultiSpike", reset=None, **fields):
    import sinabs.activation as activation
    import sinabs.layers as own

    if kind.startswith("ExpLeak"):
        return getattr(own, kind)(**fields)
    spikes = activation.MaxSpike(1) if spikes == "MaxSpike" else getattr(activation, spikes)
    how = getattr(activation, reset or "MembraneSubtract")()
    return getattr(own, kind)(spike_fn=spikes, reset_fn=how, **fields)


def spikingjelly(kind, **fields):
    from spikingjelly.activation_based import neuron

    return getattr(neuron, kind)(**fields)


TAUS = torch.linspace(3, 9, 6)
NEURONS = {
    "norse-LIFCell": lambda: norse("LIFCell"),
    "norse-LIFCell-each": lambda: norse(
        "LIFCell", tau_mem_inv=torch.linspace(80, 200, 6), v_th=torch.linspace(0.3, 1, 6)
    ),
    "norse-LIFCell-shifted": lambda: norse("LIFCell", v_leak=0.2, v_reset=0.2),
    "norse-LIFCell-alpha": lambda: norse("LIFCell", alpha=10.0),
    "norse-LIFBoxCell": lambda: norse("LIFBoxCell"),
    "norse-LIFBoxCell-subtract": lambda: norse("LIFBoxCell", subtract=True),
    "norse-IAFCell": lambda: norse("IAFCell"),
    "norse-IAFCell-shifted": lambda: norse("IAFCell", v_reset=-0.3),
    "norse-LIFRecurrentCell": lambda: norse("LIFRecurrentCell"),
    "norse-LIF": lambda: norse("LIF"),
    "norse-LIFRecurrent": lambda: norse("LIFRecurrent"),
    "norse-LICell": lambda: norse("LICell"),
    "norse-LI-over-time": lambda: norse("LI"),
    "norse-LILinearCell": lambda: norse("LILinearCell"),
    "sinabs-IAF": lambda: sinabs("IAF"),
    "sinabs-IAF-floor": lambda: sinabs("IAF", min_v_mem=-1.0),
    "sinabs-IAF-floor-zero": lambda: sinabs("IAF", min_v_mem=0.0),
    "sinabs-IAF-reset": lambda: sinabs("IAF", reset="MembraneReset"),
    "sinabs-IAF-single": lambda: sinabs("IAF", "SingleSpike"),
    "sinabs-IAF-max": lambda: sinabs("IAF", "MaxSpike", "MembraneReset"),
    "sinabs-LIF": lambda: sinabs("LIF", tau_mem=5.0),
    "sinabs-LIF-each": lambda: sinabs("LIF", tau_mem=TAUS, spike_threshold=TAUS / 9),
    "sinabs-LIF-whole-input": lambda: sinabs("LIF", tau_mem=TAUS, norm_input=False),
    "sinabs-LIF-current": lambda: sinabs("LIF", tau_mem=5.0, tau_syn=3.0),
    "sinabs-LIF-alphas": lambda: sinabs("LIF", "SingleSpike", tau_mem=5.0, train_alphas=True),
    "sinabs-ExpLeak": lambda: sinabs("ExpLeak", tau_mem=5.0),
    "sinabs-ExpLeak-normed": lambda: sinabs("ExpLeak", tau_mem=TAUS, norm_input=True),
    **{
        f"spikingjelly-{kind}-{mode}-{word}": lambda kind=kind, mode=mode, fields=fields: (
            spikingjelly(kind, step_mode=mode, **fields)
        )
        for kind in ("IFNode", "LIFNode", "ParametricLIFNode")
        for mode in "sm"
        for word, fields in {
            "zero": {},
            "shifted": {"v_reset": -0.5},
            "subtract": {"v_reset": None},
            **({} if kind == "IFNode" else {"whole-input": {"decay_input": False}}),
        }.items()
    },
}
READOUTS = ("LICell", "LI-", "LILinear", "ExpLeak")
# whose reset lets no gradient through, or which may spike several times
DETACHED = ("Recurrent", "IAF-reset", "IAF-max")


def raster(*shape, timesteps=40):
    generator = torch.Generator().manual_seed(1)
    return (torch.rand(timesteps, 3, *shape, generator=generator) < 0.4).float()


def network(name, dtype=torch.float32):
    """A linear layer and the neurons of a case, which spike and are silent."""
    kind = library(name)
    torch.manual_seed(0)
    layers = nn.Linear(8, 6), NEURONS[name]()
    join = kind.SequentialState if name.startswith("norse") else nn.Sequential
    with torch.no_grad():
        layers[0].weight.mul_(6)
    return join(*layers).to(dtype)


def own_output(name, net, x):
    """Return what the library puts out for (T, B, ...), from zero states."""
    if name.startswith("sinabs"):
        net[-1].reset_states()
        return net(x.swapaxes(0, 1)).swapaxes(0, 1)
    if name.startswith("spikingjelly"):
        net[-1].reset()
        return net(x) if net[-1].step_mode == "m" else torch.stack([net(row) for row in x])
    if not name.endswith("Cell") and "Cell-" not in name:
        return net(x)[0]
    found, state = [], None
    for row in x:
        out, state = net(row, state)
        found.append(out)
    return torch.stack(found)


def run(net, x, path, shape):
    exported = sd.export(net, path, shape)
    return exported.run(x.numpy().swapaxes(0, 1).astype(np.uint8)).outputs["output"].swapaxes(0, 1)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64], ids=["single", "double"])
@pytest.mark.parametrize("name", NEURONS)
def test_an_exported_layer_computes_in_float_what_its_library_does(name, dtype, tmp_path):
    net, x = network(name, dtype), raster(8)
    expected = own_output(name, net, x.to(dtype)).detach()
    found = run(net, x, tmp_path / "net.nir", (8,))
    if any(each in name for each in READOUTS):
        tolerance = 1e-12 if dtype == torch.float64 else 1e-5
        np.testing.assert_allclose(found, expected.numpy(), rtol=tolerance, atol=tolerance)
        return
    assert 10 < expected.sum() < 2 * expected.numel()
    np.testing.assert_array_equal(found, expected.numpy())


def test_norse_networks_over_time_are_exported(tmp_path):
    own = library("norse-")
    torch.manual_seed(0)
    net = own.SequentialState(
        own.Lift(nn.Conv2d(2, 3, 3)), own.LIF(), own.Lift(nn.AvgPool2d(2)), nn.Flatten(2),
        nn.Linear(27, 5), own.LIFRecurrent(5, 4), nn.Linear(4, 2), own.LI(),
    )  # fmt: skip
    with torch.no_grad():
        for weight in (net[0].lifted_module.weight, net[4].weight):
            weight.mul_(12)
    x = raster(2, 8, 8)
    expected = net(x)[0].detach().numpy()
    np.testing.assert_allclose(run(net, x, tmp_path / "n.nir", (2, 8, 8)), expected, atol=1e-5)
    assert np.abs(expected).max() > 0.1


def test_sinabs_networks_with_batch_and_time_in_one_axis_are_exported(tmp_path):
    own = library("sinabs-")
    torch.manual_seed(0)
    net = nn.Sequential(
        nn.Conv2d(2, 4, 3, bias=False), own.IAFSqueeze(batch_size=3, min_v_mem=-1.0),
        own.SumPool2d(2), nn.Flatten(), nn.Linear(36, 5, bias=False),
        own.IAFSqueeze(batch_size=3, min_v_mem=-1.0),
    )  # fmt: skip
    with torch.no_grad():
        net[0].weight.mul_(3)
        net[4].weight.mul_(5)
    x = raster(2, 8, 8)
    expected = net(x.swapaxes(0, 1).flatten(0, 1)).unflatten(0, (3, -1)).swapaxes(0, 1)
    found = run(net, x, tmp_path / "n.nir", (2, 8, 8))
    assert expected.sum() > 10
    np.testing.assert_array_equal(found, expected.detach().numpy())


@pytest.mark.parametrize("repeated", [False, True])
def test_spikingjelly_networks_of_several_steps_are_exported(repeated, tmp_path):
    library("spikingjelly-")
    from spikingjelly.activation_based import functional, layer, neuron

    torch.manual_seed(0)
    net = nn.Sequential(
        layer.SeqToANNContainer(nn.Conv2d(2, 4, 3, bias=False), nn.BatchNorm2d(4)),
        neuron.LIFNode(), layer.AvgPool2d(2), layer.Flatten(), layer.Dropout(0.5),
        layer.Linear(36, 5), neuron.ParametricLIFNode(),
    )  # fmt: skip
    functional.set_step_mode(net, "m")
    net.eval()
    with torch.no_grad():
        net[0][0].weight.mul_(9)
        net[5].weight.add_(0.02).mul_(12)

    class Repeated(nn.Module):
        """One image in all timesteps, as tutorials of SpikingJelly have it."""

        def __init__(self):
            super().__init__()
            self.net = net

        def forward(self, x):
            return self.net(x.unsqueeze(0).repeat(40, 1, 1, 1, 1))

    x = raster(2, 8, 8)
    if repeated:
        x = x[:1].expand(40, -1, -1, -1, -1)
    expected = (Repeated()(x[0]) if repeated else net(x)).detach().numpy()
    before = net[1].v.clone()
    found = run(Repeated() if repeated else net, x, tmp_path / "n.nir", (2, 8, 8))
    assert 10 < expected.sum() < expected.size
    np.testing.assert_array_equal(found, expected)
    torch.testing.assert_close(net[1].v, before)  # its states are as they were


@pytest.mark.parametrize(
    "name",
    [n for n in NEURONS if not any(each in n for each in DETACHED)
     and (not n.startswith("sinabs") or "single" in n or "alphas" in n or "ExpLeak" in n)],
)  # fmt: skip
def test_on_ideal_gradients_are_those_of_the_library(name):
    net, x = network(name), raster(8, timesteps=12)
    learnt = dict(net.named_parameters())
    if hasattr(net[-1], "p"):  # Norse keeps its parameters outside of torch's
        rate = nn.Parameter(getattr(net[-1].p, "tau_mem_inv", torch.tensor(1.0)).clone())
        if hasattr(net[-1].p, "tau_mem_inv"):
            net[-1].p = net[-1].p._replace(tau_mem_inv=rate)
            learnt["tau_mem_inv"] = rate
    expected = own_output(name, net, x)
    weight = torch.randn(expected.shape)
    (expected * weight).sum().backward()
    gradients = {n: p.grad for n, p in learnt.items() if p.grad is not None}
    assert len(gradients) >= 2
    for parameter in learnt.values():
        parameter.grad = None
    out = sd.on_chip(net, "ideal", (8,))(x)
    torch.testing.assert_close(out, expected, rtol=1e-5, atol=1e-5)
    (out * weight).sum().backward()
    for each, gradient in gradients.items():
        torch.testing.assert_close(learnt[each].grad, gradient, rtol=1e-3, atol=1e-5)


def test_norse_time_constants_that_are_learnt_are_seen_to_change():
    library("norse-")
    rate = nn.Parameter(torch.tensor(100.0))
    module = sd.on_chip(nn.Sequential(nn.Linear(8, 6), norse("LIFCell", tau_mem_inv=rate)),
                        "ideal", (8,), limits=False)  # fmt: skip
    before = module.artifact().neurons
    module(raster(8))
    with torch.no_grad():
        rate.mul_(2)
    (now,), (then,) = module.artifact().neurons.values(), before.values()
    assert (now.membrane_decay < then.membrane_decay).all()
    program = module.program()
    assert program is module.program()
    assert any(p is rate for p in module.parameters())
