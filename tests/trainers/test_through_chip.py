"""Networks trained through a chip: forward goes the chip, backward what snnTorch differentiates."""

import gc
import warnings
import weakref
from dataclasses import replace
from itertools import pairwise

import nir
import numpy as np
import pytest

torch = pytest.importorskip("torch")
snn = pytest.importorskip("snntorch")

from snntorch import utils  # noqa: E402
from torch import nn  # noqa: E402

import spikedeploy as sd  # noqa: E402
from spikedeploy.runtime.artifact.artifact import Artifact, load  # noqa: E402
from spikedeploy.runtime.chips import CHIPS  # noqa: E402
from spikedeploy.runtime.chips.chip import chip  # noqa: E402
from spikedeploy.runtime.compiler.compile import compile_program  # noqa: E402
from spikedeploy.runtime.convention import Convention  # noqa: E402
from spikedeploy.runtime.emulator.machine import Machine  # noqa: E402
from spikedeploy.runtime.errors import ArtifactError, ConfigError, ObservationError  # noqa: E402
from spikedeploy.trainers.through_chip import on_chip  # noqa: E402
from spikedeploy.trainers.torch_network import Weights  # noqa: E402


def leaky(beta=0.9, reset="zero", delay=False, **more):
    return snn.Leaky(beta=beta, reset_mechanism=reset, reset_delay=delay, **more)


def synaptic(reset="zero", **more):
    return snn.Synaptic(alpha=0.5, beta=0.9, reset_mechanism=reset, reset_delay=False, **more)


# of initial weights: spikes are not rare, and no membrane is above the threshold after its reset
# by subtraction, where snnTorch waits until twice the threshold and no chip does
GAINS = {"zero": 3.0, "subtract": 1.5}


def dense(neurons, gain=GAINS["zero"]):
    torch.manual_seed(0)
    net = nn.Sequential(nn.Linear(8, 12), neurons(), nn.Linear(12, 5), neurons())
    with torch.no_grad():
        for layer in net[::2]:
            layer.weight.mul_(gain)
    return net


def convolutional(neurons):
    torch.manual_seed(0)
    return nn.Sequential(
        nn.Conv2d(2, 4, 3), neurons(), nn.AvgPool2d(2), nn.Flatten(),
        nn.Linear(36, 5), neurons(),
    )  # fmt: skip


class Recurrent(nn.Module):
    """A layer that hears its own spikes, written as a loop over timesteps."""

    def __init__(self, neurons):
        super().__init__()
        self.fc1, self.fc2 = nn.Linear(8, 12), nn.Linear(12, 5)
        self.back = nn.Linear(12, 12, bias=False)
        self.lif1, self.lif2 = neurons(), neurons()

    def forward(self, x):
        spikes, seen = torch.zeros(x.shape[1], 12), []
        self.lif1.reset_mem(), self.lif2.reset_mem()
        state1, state2 = [], []
        for t in range(x.size(0)):
            spikes, *state1 = self.lif1(self.fc1(x[t]) + self.back(spikes), *state1)
            out, *state2 = self.lif2(self.fc2(spikes), *state2)
            seen.append(out)
        return torch.stack(seen)


def neurons_for(name):
    """Neurons that the chip has."""
    target = chip(name)
    reset = "zero" if "zero" in target.resets else "subtract"
    if name.startswith("xylo"):
        return lambda: synaptic(reset)
    lossless = target.limits is not None and target.limits.membrane_loss == (0.0, 0.0)
    return lambda: leaky(1.0 if lossless else 0.9375, reset)


def raster(*shape, timesteps=7, batch=3):
    generator = torch.Generator().manual_seed(1)
    return (torch.rand(timesteps, batch, *shape, generator=generator) < 0.4).float()


@pytest.fixture(autouse=True)
def _nearest():
    """A neuron that a chip does not have is trained as the nearest, with a warning."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*the nearest")
        yield


@pytest.mark.parametrize("kind", ["dense", "convolutional", "recurrent"])
@pytest.mark.parametrize("name", sorted(CHIPS))
def test_the_forward_pass_is_the_program_of_the_saved_file(name, kind, tmp_path):
    neurons = neurons_for(name)
    shape = (2, 8, 8) if kind == "convolutional" else (8,)
    net = {"dense": dense, "convolutional": convolutional, "recurrent": Recurrent}[kind](neurons)
    if (name, kind) == ("spiker", "recurrent"):
        pytest.skip("its spikes come back a timestep late, and this network has no time for that")
    module = on_chip(net, name, shape, limits=False)
    with torch.no_grad():  # after an update
        for parameter in net.parameters():
            parameter.add_(0.05 * torch.randn(parameter.shape))
    x = raster(*shape)
    out = module(x)
    program = compile_program(load(module.save(tmp_path / "net.nir")), chip(name), limits=False)
    machine = Machine(program, batch=None, trace=True, backend="interpreter")
    expected = machine.infer(x.flatten(2).numpy().swapaxes(0, 1).astype(np.uint8))
    np.testing.assert_array_equal(out.detach().flatten(2).numpy(), expected.swapaxes(0, 1))
    for layer in program.spiking:
        seen = module.spikes[layer.name].detach().flatten(2).numpy()
        np.testing.assert_array_equal(seen, machine.spikes[layer.name].swapaxes(0, 1))
    out.sum().backward()
    assert all(p.grad is not None and p.grad.isfinite().all() for p in net.parameters())


@pytest.mark.parametrize("reset", ["zero", "subtract"])
@pytest.mark.parametrize("make", [leaky, synaptic])
def test_on_ideal_outputs_and_gradients_are_those_of_snntorch(make, reset):
    net = dense(
        lambda: make(reset=reset, init_hidden=True), GAINS[reset] / (1 + (make is synaptic))
    )
    x, weight = raster(8, timesteps=12), torch.randn(12, 3, 5)
    utils.reset(net)
    expected = torch.stack([net(row) for row in x])
    (expected * weight).sum().backward()
    gradients = [p.grad.clone() for p in net.parameters()]
    net.zero_grad()
    out = on_chip(net, "ideal", (8,))(x)
    (out * weight).sum().backward()
    assert expected.sum() > 0
    torch.testing.assert_close(out, expected)
    for parameter, gradient in zip(net.parameters(), gradients, strict=True):
        torch.testing.assert_close(parameter.grad, gradient, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("reset", ["zero", "subtract"])
def test_gradients_through_a_loop_are_those_of_torch(reset):
    torch.manual_seed(3)
    net = Recurrent(lambda: leaky(reset=reset))
    with torch.no_grad():
        for parameter in net.parameters():
            parameter.mul_(GAINS[reset] / 1.5)
    x, weight = raster(8, timesteps=9), torch.randn(9, 3, 5)
    expected = net(x)
    (expected * weight).sum().backward()
    gradients = [p.grad.clone() for p in net.parameters()]
    net.zero_grad()
    out = on_chip(net, "ideal", (8,))(x)
    (out * weight).sum().backward()
    torch.testing.assert_close(out, expected)
    for parameter, gradient in zip(net.parameters(), gradients, strict=True):
        torch.testing.assert_close(parameter.grad, gradient, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("chip_name", ["ideal", "loihi1", "spiker"])
def test_all_timesteps_at_once_have_the_gradients_of_one_after_another(chip_name):
    """Of decay factors, thresholds and leaks of a file, too."""
    n = 6
    rest = {"v_threshold": np.full(n, 0.8), "v_reset": np.zeros(n), "v_leak": np.full(n, 0.02)}
    if chip_name == "spiker":
        rest["v_leak"] = np.zeros(n)
    lif = nir.LIF(tau=np.full(n, 8e-3), r=np.full(n, 8.0), **rest)
    rng = np.random.default_rng(0)
    nodes = {
        "input": nir.Input({"input": np.array([8])}),
        "fc": nir.Linear(rng.normal(size=(n, 8)) * 0.6),
        "lif": lif,
        "output": nir.Output({"output": np.array([n])}),
    }
    edges = [("input", "fc"), ("fc", "lif"), ("lif", "output")]
    reset = "zero" if "zero" in chip(chip_name).resets else "subtract"
    artifact = Artifact(nir.NIRGraph(nodes, edges), None, Convention(1e-3, reset))
    gradients = []
    for one_by_one in (False, True):
        module = on_chip(artifact, chip_name, limits=False)
        module._timing = replace(module._timing, loops=one_by_one)
        (module(raster(8, timesteps=12)) * torch.arange(n)).sum().backward()
        gradients.append({name: p.grad for name, p in module.named_parameters()})
    assert {name.rpartition(".")[2] for name in gradients[0]} >= {"membrane_decay", "threshold"}
    for name, gradient in gradients[0].items():
        torch.testing.assert_close(gradient, gradients[1][name], rtol=1e-4, atol=1e-5)


def test_gradients_of_what_a_delay_holds_back_go_to_the_timestep_that_it_came_from():
    n = 2
    rest = {"tau": np.full(n, 4e-3), "r": np.full(n, 4.0), "v_leak": np.zeros(n)}
    nodes = {
        "input": nir.Input({"input": np.array([n])}),
        "delay": nir.Delay(np.array([2e-3, 1e-3])),
        "fc": nir.Linear(np.eye(n)),
        "out": nir.LI(**rest),
        "output": nir.Output({"output": np.array([n])}),
    }
    names = list(nodes)
    graph = nir.NIRGraph(nodes, list(pairwise(names)), type_check=False)
    module = on_chip(Artifact(graph, None, Convention(1e-3)), "ideal", limits=False)
    x = torch.ones(5, 1, n, requires_grad=True)
    module(x)[4].sum().backward()
    b = 0.75  # V = b V + x: each timestep earlier counts b times
    expected = [[b**2, b**3], [b, b**2], [1, b], [0, 1], [0, 0]]
    torch.testing.assert_close(x.grad[:, 0], torch.tensor(expected))


def test_one_weight_more_costs_what_a_finite_difference_of_the_membranes_says():
    """Of a readout, which does not spike, so that nothing has to be smoothed."""
    torch.manual_seed(0)
    net = nn.Sequential(nn.Linear(8, 4), snn.Leaky(0.9, reset_mechanism="none"))

    class Membranes(nn.Module):
        def __init__(self):
            super().__init__()
            self.net = net

        def forward(self, x):
            return self.net(x)[1]

    module = on_chip(Membranes(), "ideal", (8,))
    x = raster(8)
    module(x).sum().backward()
    with torch.no_grad():
        before = float(module(x).double().sum())
        net[0].weight[1, 2] += 1e-2
        after = float(module(x).double().sum())
    assert (after - before) / 1e-2 == pytest.approx(float(net[0].weight.grad[1, 2]), rel=1e-3)


@pytest.mark.parametrize("name", ["int:weight_bits=2", "loihi1:weight_bits=1"])
def test_training_through_few_bits_learns_what_rounding_destroys(name):
    torch.manual_seed(0)
    x = raster(8, timesteps=8, batch=64)
    labels = (x.sum(0)[:, :4].sum(1) > x.sum(0)[:, 4:].sum(1)).long()
    net = nn.Sequential(nn.Linear(8, 24), leaky(), nn.Linear(24, 2), leaky())
    module = on_chip(net, name, (8,), limits=False)
    optimiser = torch.optim.Adam(net.parameters(), 0.02)
    losses = []
    for _ in range(60):
        loss = nn.functional.cross_entropy(module(x).sum(0), labels)
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        losses.append(loss.item())
    assert losses[-1] < 0.75 * losses[0]


NEURONS = {
    "Leaky": lambda **how: snn.Leaky(beta=0.8, **how),
    "Synaptic": lambda **how: snn.Synaptic(alpha=0.6, beta=0.8, **how),
    "RLeaky": lambda **how: snn.RLeaky(beta=0.8, linear_features=6, **how),
    "RSynaptic": lambda **how: snn.RSynaptic(alpha=0.6, beta=0.8, linear_features=6, **how),
    "Lapicque": lambda reset_delay, **how: snn.Lapicque(beta=0.8, **how),
}


@pytest.mark.parametrize(
    ("kind", "late"),  # RSynaptic has no reset_delay=False: snnTorch 1.0.0 divides None by a tensor
    [(kind, late) for kind in NEURONS for late in (True, False) if late or kind != "RSynaptic"],
)
@pytest.mark.parametrize("reset", ["zero", "subtract"])
def test_an_exported_module_computes_in_float_what_snntorch_does(kind, reset, late, tmp_path):
    torch.manual_seed(2)
    neurons = NEURONS[kind](reset_mechanism=reset, reset_delay=late)
    net = nn.Sequential(nn.Linear(8, 6), neurons)
    with torch.no_grad():  # Lapicque's input counts dt / C = -log(beta) times
        net[0].weight.mul_(12 if kind == "Lapicque" else 3)
    x, expected = raster(8, timesteps=40), []
    states = [torch.zeros(3, 6) for _ in neurons.reset_mem()] if kind[0] == "R" else []
    for row in x:
        found = neurons(net[0](row), *states)
        # recurrent neurons take their spikes back, others their states alone
        states = found if kind[0] == "R" else found[1:]
        expected.append(found[0])
    expected = torch.stack(expected).detach()
    run = sd.export(net, tmp_path / "net.nir", (8,)).run(x.numpy().swapaxes(0, 1).astype(np.uint8))
    assert 20 < expected.sum() < expected.numel() - 20
    np.testing.assert_array_equal(run.outputs["output"].swapaxes(0, 1), expected.numpy())


class Passed(nn.Module):
    """States passed in and out, as in snnTorch's documentation."""

    def __init__(self):
        super().__init__()
        self.fc1, self.lif1 = nn.Linear(8, 12), leaky()
        self.fc2, self.lif2 = nn.Linear(12, 5), leaky()

    def forward(self, x, mem1, mem2):
        spikes, mem1 = self.lif1(self.fc1(x), mem1)
        out, mem2 = self.lif2(self.fc2(spikes), mem2)
        return out, mem1, mem2


class Static(Passed):
    """A loop over timesteps of one input, through a view, with dropout and normalisation."""

    def __init__(self):
        super().__init__()
        self.norm, self.drop = nn.BatchNorm1d(12), nn.Dropout(0.5)

    def forward(self, x):
        mem1, mem2, seen = self.lif1.reset_mem(), self.lif2.reset_mem(), []
        current = self.norm(self.fc1(x.view(x.size(0), -1)))
        for _ in range(4):
            spikes, mem1 = self.lif1(current, mem1)
            out, mem2 = self.lif2(self.fc2(self.drop(spikes)), mem2)
            seen.append(out)
        return torch.stack(seen, dim=0), mem2


@pytest.mark.parametrize(
    ("make", "shape"),
    [(lambda: dense(leaky), (8,)), (Passed, (8,)), (Static, (8,)), (Static, (2, 4))],
)
def test_ways_to_write_a_network_are_one_network(make, shape):
    module = on_chip(make(), "loihi1", shape)
    kinds = [type(each).__name__ for each in module.artifact().neurons.values()]
    assert len(kinds) == 2
    assert module(raster(*shape)).shape == (7, 3, 5)


def test_tracing_leaves_states_and_statistics_as_they_were():
    net = Static()
    net.train()
    before = {name: value.clone() for name, value in net.state_dict().items()}
    on_chip(net, "loihi1", (8,))
    assert net.training
    assert net.lif1.mem.numel() == 0
    for name, value in net.state_dict().items():
        torch.testing.assert_close(value, before[name])


class Pooled(nn.Module):
    def __init__(self, between):
        super().__init__()
        self.conv, self.lif, self.between = nn.Conv2d(1, 2, 3), leaky(), between
        self.out, self.last = nn.Linear(18, 2), leaky()

    def forward(self, x):
        spikes, membrane = self.lif(self.conv(x))
        return self.last(self.out(self.between(spikes, membrane).flatten(1)))


@pytest.mark.parametrize(
    ("between", "found"),
    [
        (lambda s, _: nn.functional.max_pool2d(s, 2), "max_pool2d"),
        (lambda s, _: nn.functional.avg_pool2d(torch.relu(s), 2), "relu"),
        (lambda _, m: m[:, :, :3, :3], "__getitem__"),
    ],
)
def test_what_no_chip_computes_between_layers_is_named(between, found):
    with pytest.raises(ConfigError, match=found):
        on_chip(Pooled(between), "loihi1", (1, 8, 8))


class Shared(Passed):
    """A layer that works at two places of a timestep."""

    def __init__(self):
        super().__init__()
        self.same = nn.Linear(12, 12)

    def forward(self, x):
        first, _ = self.lif1(self.fc1(x))
        out, _ = self.lif2(self.fc2(self.same(first) + self.same(self.same(first))))
        return out


class Joined(Passed):
    def forward(self, x):
        hidden, _ = self.lif1(self.fc1(x))
        out, _ = self.lif2(self.fc2(hidden))
        return torch.cat([hidden, out], dim=1)


class Written(Passed):
    def forward(self, x):
        hidden, _ = self.lif1(self.fc1(x))
        hidden[:, 0] = 0
        return self.lif2(self.fc2(hidden))


@pytest.mark.parametrize(
    ("net", "words"),
    [
        (Shared(), "same: it is called 6 times in 2 timesteps"),
        (Joined(), "its output does not come from its layers alone"),
        (Written(), "what __setitem__ makes"),
        (nn.Sequential(nn.Linear(8, 2), nn.ReLU()), "1: ReLU has no place on a chip"),
        (nn.Sequential(nn.Linear(8, 2)), "no neurons that are known"),
        (nn.Sequential(nn.Linear(7, 2), leaky()), "forward failed"),
        (nn.Sequential(nn.Linear(8, 4), leaky(reset="zero"), nn.Linear(4, 2),
                       leaky(reset="subtract")), "several ways"),
    ],
)  # fmt: skip
def test_a_module_that_is_no_network_on_a_chip_is_refused(net, words):
    with pytest.raises(ConfigError, match=words):
        on_chip(net, "loihi1", (8,))


class Between(Passed):
    """Something of the user between a layer's input and its neurons."""

    def __init__(self, between):
        super().__init__()
        self.between = between

    def forward(self, x):
        hidden, _ = self.lif1(self.between(x, self.fc1(x)))
        out, _ = self.lif2(self.fc2(hidden))
        return out


@pytest.mark.parametrize(
    ("between", "words"),
    [
        (lambda _, y: y + 1.0, "lif1: it receives what add makes"),
        (lambda _, y: y + y, "what add makes"),
        (lambda _, y: torch.add(y, y, alpha=3), "what add makes"),
        (lambda _, y: torch.cat([y[:, :6], y[:, 6:]], 1), "__getitem__"),
        (lambda x, _: 1 / 0, "ZeroDivisionError: division by zero"),
    ],
)
def test_constants_factors_and_errors_of_a_forward_are_refused(between, words):
    """None of them is left out of the network in silence."""
    with pytest.raises(ConfigError, match=words):
        on_chip(Between(between), "loihi1", (8,))


class Named(nn.Module):
    """Layers by the names that a graph has for its ends."""

    def __init__(self):
        super().__init__()
        self.input, self.output = nn.Linear(8, 6), leaky()

    def forward(self, x):
        return self.output(self.input(x))[0]


def test_layers_may_be_called_input_and_output():
    assert on_chip(Named(), "loihi1", (8,))(raster(8)).shape == (7, 3, 6)


@pytest.mark.parametrize(
    ("net", "shape", "words"),
    [
        (Named, (8,), "found the class Named"),
        (3, (8,), "found a int"),
        (Named(), "ab", "input_shape is 'ab'"),
        (Named(), (8.5,), "give whole numbers"),
    ],
)
def test_what_is_no_module_or_shape_is_refused(net, shape, words):
    with pytest.raises(ConfigError, match=words):
        on_chip(net, "loihi1", shape)


def test_a_surrogate_without_a_width_is_refused():
    with pytest.raises(ConfigError, match="width of the surrogate is -1"):
        on_chip(dense(leaky), "loihi1", (8,), surrogate_width=-1.0)


def test_spikes_of_every_type_are_those_of_the_networks_numbers():
    module, spikes = on_chip(dense(leaky), "loihi1", (8,)), raster(8)
    wanted = module(spikes)
    for kind in (torch.bool, torch.uint8, torch.float64, torch.float16):
        assert torch.equal(module(spikes.to(kind)), wanted)


def test_numbers_that_no_longer_fit_say_that_they_did():
    net = dense(lambda: leaky(learn_threshold=True))
    module = on_chip(net, "loihi1", (8,))
    with torch.no_grad():
        net[1].threshold.fill_(-1.0)
    with pytest.raises(ArtifactError, match="It fitted before the last update"):
        module(raster(8))


def test_a_neuron_that_no_chip_has_is_trained_as_the_nearest_and_this_is_said():
    with pytest.warns(UserWarning, match=r"the nearest that it does, reset 'zero'"):
        on_chip(dense(lambda: snn.Leaky(beta=0.9)), "loihi1", (8,))


def test_inputs_that_are_no_spikes_are_refused():
    module = on_chip(dense(leaky), "loihi1", (8,))
    with pytest.raises(ObservationError, match=r"from 0\.5 to 0\.5"):
        module(torch.full((4, 2, 8), 0.5))
    with pytest.raises(ObservationError, match=r"takes \(T, B, 8\)"):
        module(torch.zeros(4, 8))
    with pytest.raises(ObservationError, match="at least one timestep and one sample"):
        module(torch.zeros(0, 2, 8))
    with pytest.raises(ObservationError, match="a ndarray, and the module takes tensors"):
        module(np.zeros((4, 2, 8)))


def test_weights_that_are_no_numbers_are_named():
    net = dense(leaky)
    module = on_chip(net, "loihi1", (8,))
    with torch.no_grad():
        net[2].weight[0, 0] = float("nan")
    with pytest.raises(ConfigError, match="weight of '2' holds nan after an update"):
        module(raster(8))
    with pytest.raises(ConfigError, match="holds nan as the network was given"):
        on_chip(net, "loihi1", (8,))


def test_an_update_leaves_no_tensors_behind():
    module = on_chip(dense(leaky), "loihi1", (8,))
    module(raster(8)).sum().backward()
    held = weakref.ref(next(iter(module.spikes.values())))
    module.spikes = {}
    gc.collect()
    assert held() is None


@pytest.mark.parametrize("name", ["odin", "truenorth"])
def test_axons_change_a_network_once_and_say_so(name, tmp_path):
    with pytest.warns(UserWarning, match=f"{name} has .* % of the weights, by magnitude, change"):
        module = on_chip(dense(lambda: leaky(1.0)), name, (8,))
    with torch.no_grad():
        for node in module.network.nodes.values():  # an update
            if isinstance(node, Weights):
                node.layer.weight.add_(0.02 * torch.randn(node.layer.weight.shape))
    expected = module(raster(8))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        again = on_chip(load(module.save(tmp_path / "net.nir")), name)
    assert torch.equal(again(raster(8)), expected)


class Looping(nn.Module):
    """A loop over timesteps, of which each reads what `pick` gives it of the input."""

    def __init__(self, pick):
        super().__init__()
        torch.manual_seed(0)
        self.fc, self.pick = nn.Linear(4, 3), pick
        self.lif = snn.Leaky(0.9, reset_mechanism="subtract", init_hidden=False)

    def forward(self, x):
        membrane, found = self.lif.init_leaky(), []
        for t in range(len(x)):
            spikes, membrane = self.lif(self.fc(self.pick(x, t)), membrane)
            found.append(spikes)
        return torch.stack(found)


def before(x, t):
    return x[t - 1] if t else torch.zeros(x.shape[1:])


@pytest.mark.parametrize("pick", [lambda x, t: x[t], lambda x, t: x.select(0, t), before,
                                  lambda x, t: x.unbind()[t]])  # fmt: skip
def test_a_timestep_is_read_by_its_number(pick):
    net = Looping(pick)
    spikes = (torch.rand(12, 5, 4) < 0.5).float()
    with torch.no_grad():
        found = sd.on_chip(net, "ideal", (4,))(spikes)
        wanted = sd.on_chip(Looping(lambda x, t: x[t]), "ideal", (4,))(
            torch.stack([pick(spikes, t) for t in range(12)])
        )
    assert torch.equal(found, wanted)


@pytest.mark.parametrize(
    "pick",
    [
        lambda x, t: x[t - 1],
        lambda x, t: x[0],
        lambda x, t: x[-1 - t],
        lambda x, t: x[t] + before(x, t),
        lambda x, t: x.select(-1, t % 4)[..., None].expand(12, 5, 4)[0],
        lambda x, t: x.unbind(-1)[0][..., None].expand(12, 5, 4)[0],
    ],
)
def test_a_loop_that_reads_other_timesteps_is_refused(pick):
    with pytest.raises(ConfigError, match=r"fc|Looping"):
        sd.on_chip(Looping(pick), "ideal", (4,))
