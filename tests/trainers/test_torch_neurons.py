"""Refusals of neurons of other libraries, by stand-ins with the fields that their classes have.

test_other_libraries.py compares the libraries themselves.
"""

from types import SimpleNamespace

import pytest

torch = pytest.importorskip("torch")

from torch import nn  # noqa: E402

import spikedeploy as sd  # noqa: E402
from spikedeploy.runtime.errors import ConfigError  # noqa: E402
from spikedeploy.trainers.from_torch import artifact_from_torch  # noqa: E402


class StandIn(nn.Module):
    def __init__(self, **fields):
        super().__init__()
        for name, value in fields.items():
            setattr(self, name, value)

    def forward(self, x):
        return x


def made(library, kind, base=StandIn, **fields):
    """A module of a class of this name, in a package of the library."""
    return type(kind, (base,), {"__module__": f"{library}.neurons"})(**fields)


class Parameters(SimpleNamespace):
    def _asdict(self):
        return vars(self)


def norse(kind="LIFCell", dt=0.001, **fields):
    own = {"tau_mem_inv": 100.0, "v_leak": 0.0, "v_th": 1.0, "v_reset": 0.0, "method": "heaviside"}
    if kind == "LIFCell":
        own["tau_syn_inv"] = 200.0
    if kind == "LICell":
        own = {"tau_mem_inv": 100.0, "tau_syn_inv": 200.0, "v_leak": 0.0}
    tensors = {
        name: torch.tensor(value) if isinstance(value, float) else value
        for name, value in (own | fields).items()
    }
    return made("norse", kind, p=Parameters(**tensors), dt=dt)


def reset_subtract():
    """Named as Norse's is."""


def reset_other():
    """Of a user."""


def named(kind, **fields):
    return type(kind, (), fields)()


def sinabs(kind="IAF", **fields):
    own = {
        "spike_fn": named("MultiSpike"),
        "reset_fn": named("MembraneSubtract", subtract_value=None),
        "spike_threshold": torch.tensor(1.0),
        "min_v_mem": None,
        "norm_input": False,
        "alpha_mem_calculated": torch.tensor(0.9),
        "alpha_syn_calculated": None,
        "surrogate_grad_fn": lambda v, threshold: torch.ones_like(v - threshold),
    }
    return made("sinabs", kind, **(own | fields))


def spikingjelly(kind="LIFNode", **fields):
    own = {
        "step_mode": "s",
        "v_reset": 0.0,
        "v_threshold": 1.0,
        "tau": 2.0,
        "decay_input": True,
        "surrogate_function": SimpleNamespace(spiking=True),
    }
    return made("spikingjelly", kind, **(own | fields))


def unknown(library, kind, base):
    """A neuron of a library that has none of the known classes."""
    return made(library, kind, type(base, (StandIn,), {"__module__": library}))


def changed(neurons, kind, **methods):
    """The same neurons, of a subclass with methods of its own."""
    neurons.__class__ = type(kind, (type(neurons),), methods)
    return neurons


@pytest.mark.parametrize(
    ("neurons", "words"),
    [
        (lambda: norse(v_leak=0.5), "1: Norse's LIFCell: its membranes start at v_leak, up to 0.5"),
        (lambda: norse("LIFBoxCell", v_leak=0.5, v_reset=0.5, reset_method=reset_subtract),
         "start at v_leak, up to 0.5, and return to another"),
        (lambda: norse("LICell", v_leak=-0.5), "start at v_leak, up to -0.5"),
        (lambda: norse("LIFBoxCell", reset_method=reset_other), "reset_method reset_other is unk"),
        (lambda: norse(tau_mem_inv=2000.0), "tau_mem_inv is up to 2, and forward Euler overshoots"),
        (lambda: unknown("norse", "LSNNCell", "SNNCell"),
         "1: norse's LSNNCell has no form on a chip. Of norse these have: LIFCell, LIF"),
        (lambda: sinabs("IAFSqueeze", reset_fn=named("MembraneReset", reset_value=0.5)),
         "reset_fn .* has no place on a chip"),
        (lambda: sinabs("IAFSqueeze", reset_fn=named("MembraneSubtract", subtract_value=0.5)),
         "reset_fn .* has no place on a chip"),
        (lambda: sinabs("IAFSqueeze", spike_fn=named("MaxSpike", max_num_spikes_per_bin=3)),
         "spike_fn .* has no place on a chip"),
        (lambda: sinabs("IAFSqueeze", min_v_mem=torch.tensor(-0.5)), "min_v_mem goes to 0.5 below"),
        (lambda: sinabs("ExpLeakSqueeze", spike_fn=None, min_v_mem=torch.tensor(0.0)),
         "min_v_mem has no place on a chip"),
        (lambda: changed(sinabs("LIF"), "LIFRecurrent", forward=lambda self, x: x),
         "1: LIFRecurrent is a LIF of sinabs that has its own forward"),
        (lambda: spikingjelly(surrogate_function=SimpleNamespace(spiking=False)),
         "puts out no spikes. Call set_spiking_mode"),
        (lambda: unknown("spikingjelly", "EIFNode", "BaseNode"),
         "spikingjelly's EIFNode has no form on a chip"),
        (lambda: unknown("snntorch", "Alpha", "SpikingNeuron"),
         "snntorch's Alpha has no form on a chip. Of snntorch these have: Leaky, RLeaky"),
    ],
)  # fmt: skip
def test_neurons_without_a_form_on_a_chip_are_refused_by_name(neurons, words):
    with pytest.raises(ConfigError, match=words):
        artifact_from_torch(nn.Sequential(nn.Linear(8, 4), neurons()), (8,))


EQUATIONS = {
    # I = (1 - dt/tau_syn) I + dt/tau_mem x, V = (1 - dt/tau_mem) V + I
    "norse": (norse, {"a": 0.8, "b": 0.9, "gain": 0.1}, ("zero", "above", "none")),
    "norse-shifted": (
        lambda: norse(v_leak=0.25, v_reset=0.25),
        {"a": 0.8, "b": 0.9, "gain": 0.1, "threshold": 0.75},
        ("zero", "above", "none"),
    ),
    "norse-box": (
        lambda: norse("LIFBoxCell", reset_method=reset_subtract),
        {"b": 0.9, "gain": 0.1},
        ("subtract", "above", "none"),
    ),
    "sinabs": (lambda: sinabs("LIFSqueeze"), {"b": 0.9}, ("subtract", "many", "none")),
    "sinabs-current": (
        lambda: sinabs(
            "LIFSqueeze", norm_input=True, alpha_syn_calculated=torch.tensor(0.5),
            spike_fn=named("SingleSpike"), min_v_mem=torch.tensor(-1.0),
            reset_fn=named("MembraneReset", reset_value=0.0),
        ),
        {"a": 0.5, "b": 0.9, "gain": 0.05},
        ("zero", "reached", "threshold"),
    ),
    "spikingjelly": (spikingjelly, {"b": 0.5, "gain": 0.5}, ("zero", "reached", "none")),
    "spikingjelly-subtract": (
        lambda: spikingjelly(decay_input=False, v_reset=None),
        {"b": 0.5},
        ("subtract", "reached", "none"),
    ),
    "spikingjelly-shifted": (
        lambda: spikingjelly(v_reset=-0.5),
        {"b": 0.5, "gain": 0.5, "threshold": 1.5},
        ("zero", "reached", "none"),
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", EQUATIONS)
def test_settings_of_a_library_are_this_difference_equation(name):
    neurons, numbers, meaning = EQUATIONS[name]
    artifact = artifact_from_torch(nn.Sequential(nn.Linear(8, 4), neurons()), (8,))
    (found,) = artifact.neurons.values()
    convention = artifact.convention
    assert (convention.reset, convention.spikes, convention.floor) == meaning
    assert (found.current_decay is not None) == ("a" in numbers)
    expected = {"gain": 1.0, "threshold": 1.0} | numbers
    fields = {"a": "current_decay", "b": "membrane_decay"}
    for field, value in expected.items():
        assert getattr(found, fields.get(field, field)) == pytest.approx(value, rel=1e-6)
    assert not found.leak.any()
    assert not found.v_reset.any()


def test_a_neuron_of_snntorch_that_was_changed_is_not_taken_for_the_original():
    snn = pytest.importorskip("snntorch")

    class Leaky(snn.Leaky):
        def forward(self, x, mem=None):
            return super().forward(2 * x, mem)

    with pytest.raises(ConfigError, match=r"Leaky is a Leaky of snntorch that has its own forward"):
        artifact_from_torch(nn.Sequential(nn.Linear(8, 4), Leaky(0.9)), (8,))

    class Named(snn.Leaky):
        def __init__(self):
            super().__init__(beta=0.9)

    assert artifact_from_torch(nn.Sequential(nn.Linear(8, 4), Named()), (8,)).neurons


class OverTime(nn.Module):
    """Layers over all timesteps, first or second axis, which the forward may name."""

    def __init__(self, neurons, batch_first=False):
        super().__init__()
        self.fc, self.neurons, self.batch_first = nn.Linear(8, 4), neurons, batch_first

    def forward(self, x):
        x = self.neurons(self.fc(x))
        return x.transpose(0, 1) if self.batch_first else x


@pytest.mark.parametrize("batch_first", [False, True])
def test_layers_over_all_timesteps_are_taken(batch_first):
    net = OverTime(spikingjelly(step_mode="m"), batch_first)
    artifact = artifact_from_torch(net, (8,))
    assert sorted(type(node).__name__ for node in artifact.graph.nodes.values()) == [
        "Affine", "Input", "LIF", "Output",
    ]  # fmt: skip


def test_neurons_of_one_timestep_do_not_take_an_axis_of_time_for_the_batch():
    class Wide(OverTime):
        def forward(self, x):
            return self.neurons(self.fc(x.unsqueeze(0).repeat(5, 1, 1)))

    with pytest.raises(ConfigError, match="takes one timestep, and receives an axis more"):
        artifact_from_torch(Wide(spikingjelly()), (8,))


def test_timesteps_that_are_collected_in_a_tensor_are_the_output():
    class Collected(OverTime):
        def forward(self, x):
            seq_length, batch, _ = x.shape
            found = torch.zeros(seq_length, batch, 4)
            for t in range(seq_length):
                found[t, :, :] = self.neurons(self.fc(x[t, :]))
            return found

    assert artifact_from_torch(Collected(spikingjelly()), (8,)).neurons


@pytest.mark.parametrize("batch_first", [False, True])
@pytest.mark.parametrize("steps", [2, 25, 100])
def test_a_forward_that_counts_its_timesteps_itself_is_traced(steps, batch_first):
    class Counted(OverTime):
        def forward(self, x):
            rows = [x[:, t] if self.batch_first else x[t] for t in range(steps)]
            return torch.stack([self.neurons(self.fc(row)) for row in rows])

    net = Counted(spikingjelly(), batch_first)
    assert len(artifact_from_torch(net, (8,)).neurons) == 1
    with pytest.raises(ConfigError, match="takes all timesteps at once, and receives one"):
        artifact_from_torch(Counted(spikingjelly(step_mode="m"), batch_first), (8,))


def test_neurons_that_put_out_several_spikes_are_trained_as_the_nearest_of_a_chip():
    net = nn.Sequential(nn.Linear(8, 4), sinabs("LIFSqueeze"))
    with pytest.warns(UserWarning, match="as many spikes as fit, and loihi1 one in a timestep"):
        sd.on_chip(net, "loihi1", (8,))
