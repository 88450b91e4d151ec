"""Networks adapted to a chip: accuracy comes back, resuming changes no bit, slips are sentences."""

import warnings
from dataclasses import replace

import nir
import numpy as np
import pytest

torch = pytest.importorskip("torch")
snn = pytest.importorskip("snntorch")

from torch import nn  # noqa: E402

import spikedeploy as sd  # noqa: E402
from spikedeploy.runtime.artifact.artifact import Artifact, digest  # noqa: E402
from spikedeploy.runtime.convention import Convention  # noqa: E402
from spikedeploy.runtime.errors import ConfigError, ObservationError, RuleError  # noqa: E402
from spikedeploy.trainers import adapt as adapting  # noqa: E402
from spikedeploy.trainers.progress import Interrupt  # noqa: E402
from spikedeploy.trainers.through_chip import ChipModule  # noqa: E402

CHIP = "int:weight_bits=2"
QUICK = {"epochs": 6, "batch": 32, "patience": 6, "rate": 3e-3}


def made(samples=240, timesteps=8):
    """Spikes whose rates tell one of four classes, and the classes."""
    rng = np.random.default_rng(0)
    labels = rng.integers(4, size=samples)
    rates = np.where(rng.random((4, 16)) < 0.4, 0.6, 0.15)
    rates[:, 15] = 0
    return (rng.random((samples, timesteps, 16)) < rates[labels][:, None]).astype(np.uint8), labels


RASTER, LABELS = made()


@pytest.fixture(scope="module")
def net():
    """A torch network of float weights that tells the classes."""
    torch.manual_seed(0)
    has = {"beta": 0.9, "reset_mechanism": "zero", "reset_delay": False}
    net = nn.Sequential(nn.Linear(16, 24), snn.Leaky(**has), nn.Linear(24, 4), snn.Leaky(**has))
    module = sd.on_chip(net, "ideal", (16,))
    optimiser = torch.optim.Adam(net.parameters(), 1e-2)
    spikes = torch.from_numpy(RASTER).float().swapaxes(0, 1)
    for _ in range(60):
        loss = nn.functional.cross_entropy(module(spikes).sum(0), torch.from_numpy(LABELS))
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
    with torch.no_grad():  # of an input that is silent: it takes the bits of all others
        net[0].weight[0, 15] = 1.9
    return net


@pytest.fixture(scope="module")
def artifact(net):
    return sd.on_chip(net, "ideal", (16,)).artifact()


@pytest.fixture(autouse=True)
def quiet(monkeypatch):
    monkeypatch.setattr(adapting.ProgressBar, "say", lambda *_: None)


def test_accuracy_that_two_bits_cost_comes_back_with_labels(artifact):
    found = sd.adapt(artifact, CHIP, RASTER, LABELS, quiet=True, **QUICK)
    assert found.float_twin.accuracy > 0.9
    assert found.before.accuracy < 0.5
    assert found.after.accuracy > 0.85
    assert (found.trained, found.held_out) == (192, 48)
    assert found.finished


def test_without_labels_outputs_come_back_to_those_of_the_float_twin(artifact):
    found = sd.adapt(artifact, CHIP, RASTER, quiet=True, **QUICK)
    assert found.after.accuracy is None
    assert found.float_twin.agreement == 1
    assert found.before.agreement < 0.5
    assert found.after.agreement > 0.8
    assert found.after.error < 0.6 * found.before.error


def test_the_scores_are_those_of_the_saved_file_on_the_chip(artifact, tmp_path):
    found = sd.adapt(artifact, CHIP, RASTER, LABELS, quiet=True, **QUICK, held_out=0.5)
    loaded = sd.load(found.save(tmp_path / "net.nir"))
    assert loaded.artifact.trained_for == CHIP
    order = np.random.default_rng(0).permutation(len(RASTER))[:120]
    outputs = loaded.on(CHIP).run(RASTER[order]).outputs["output"].sum(axis=1)
    assert (outputs.argmax(axis=1) == LABELS[order]).mean() == found.after.accuracy
    assert loaded.check(CHIP).passed


def test_a_torch_module_has_the_best_numbers_afterwards(net):
    other = nn.Sequential(*(type(each)(*size(each)) if isinstance(each, nn.Linear) else each
                            for each in net))  # fmt: skip
    other.load_state_dict(net.state_dict())
    found = sd.adapt(other, CHIP, RASTER, LABELS, input_shape=(16,), quiet=True, **QUICK)
    assert not torch.equal(other[0].weight, net[0].weight)
    again = sd.on_chip(other, CHIP, (16,)).artifact()
    for name, node in again.graph.nodes.items():
        if hasattr(node, "weight"):
            np.testing.assert_array_equal(node.weight, found.artifact.graph.nodes[name].weight)


def size(linear):
    return linear.in_features, linear.out_features


class Stops(Interrupt):
    """Requests a stop when it was asked so many times."""

    def __init__(self, after):
        super().__init__()
        self.after, self.asked = after, 0

    def __call__(self):
        self.asked += 1
        self.requested = 2 if self.asked > self.after else 0
        return super().__call__()


@pytest.mark.parametrize("labels", [LABELS, None], ids=["labels", "float"])
def test_resumed_it_ends_with_the_bits_of_one_that_was_not_stopped(labels, artifact, tmp_path):
    never = Stops(10_000)
    whole = sd.adapt(artifact, CHIP, RASTER, labels, interrupt=never, quiet=True, **QUICK)
    path, stops, resume = tmp_path / "net.checkpoint.safetensors", [], False
    with pytest.raises(KeyboardInterrupt):  # nothing is trained yet, nothing is written
        sd.adapt(artifact, CHIP, RASTER, labels, checkpoint=path, interrupt=Stops(5), quiet=True)
    assert not path.exists()
    # the last 48 times that it was asked were in 36 updates and 6 validations of 2 batches
    for after in (never.asked - 30, 10, 10_000):
        found = sd.adapt(
            artifact, CHIP, RASTER, labels, checkpoint=path, resume=resume,
            interrupt=Stops(after), quiet=True, **QUICK,
        )  # fmt: skip
        resume = True
        stops.append(found.updates)
        assert found.finished == (after == 10_000)
    assert 0 < stops[0] < stops[1] < stops[2] == whole.updates
    assert digest(found.artifact) == digest(whole.artifact)
    assert found.after == whole.after
    assert found.before == whole.before


def test_a_checkpoint_of_another_adaptation_or_a_damaged_one_is_refused(artifact, tmp_path):
    path = tmp_path / "net.checkpoint.safetensors"
    sd.adapt(artifact, CHIP, RASTER, checkpoint=path, quiet=True, epochs=1)
    with pytest.raises(ConfigError, match="begun with another chip, labels, seed"):
        sd.adapt(artifact, "loihi1", RASTER, LABELS, checkpoint=path, resume=True, seed=1)
    whole = path.read_bytes()
    path.write_bytes(whole[:-4] + b"\0\0\0\1")
    with pytest.raises(ConfigError, match="checksum"):
        sd.adapt(artifact, CHIP, RASTER, checkpoint=path, resume=True)


REFUSED = {
    "labels out of range": ({"labels": LABELS + 1}, "from 0 to 3"),
    "labels below zero": ({"labels": LABELS - 1}, "from 0 to 3"),
    "labels of another number": ({"labels": LABELS[:-1]}, r"\(239,\) .* 240 samples"),
    "labels in halves": ({"labels": LABELS + 0.5}, "float64"),
    "raster of another width": ({"raster": RASTER[..., :-1]}, r"\(240, 8, 15\).*\(B, T, 16\)"),
    "one sample": ({"raster": RASTER[0], "labels": None}, "many samples"),
    "few samples": ({"raster": RASTER[:9], "labels": LABELS[:9]}, "9 samples; at least 10"),
    "no spikes": ({"raster": RASTER * 0.5}, "takes whole spikes"),
    "silence": ({"raster": RASTER * 0, "labels": None}, "nothing to adapt to"),
}


@pytest.mark.parametrize(("given", "says"), REFUSED.values(), ids=REFUSED.keys())
def test_a_slip_is_refused_before_training_with_what_was_found(given, says, artifact):
    given = {"raster": RASTER, "labels": LABELS, **given}
    with pytest.raises(ObservationError, match=says):
        sd.adapt(artifact, CHIP, quiet=True, **given)


def test_settings_out_of_range_are_refused(artifact):
    wrongs = (
        {"epochs": 0}, {"batch": 0}, {"batch": 2.5}, {"seed": -1}, {"rate": float("nan")},
        {"held_out": 1.0},
    )  # fmt: skip
    for wrong in wrongs:
        with pytest.raises(ConfigError, match=next(iter(wrong))):
            sd.adapt(artifact, CHIP, RASTER, **wrong)


def test_resuming_asks_for_a_checkpoint(artifact):
    with pytest.raises(ConfigError, match="give the one that was written"):
        sd.adapt(artifact, CHIP, RASTER, resume=True, quiet=True)


class Tied(nn.Module):
    """Two layers with one matrix, thresholds that are learnt, and a layer that is not trained."""

    def __init__(self):
        super().__init__()
        has = {"beta": 0.9, "init_hidden": True, "reset_mechanism": "zero", "reset_delay": False}
        self.fc1, self.lif1 = nn.Linear(16, 8), snn.Leaky(**has)
        self.fc2, self.lif2 = nn.Linear(8, 8), snn.Leaky(**has, learn_threshold=True)
        self.fc3, self.lif3 = nn.Linear(8, 8), snn.Leaky(**has)
        self.fc3.weight = self.fc2.weight
        self.fc1.weight.requires_grad_(False)

    def forward(self, x):
        return self.lif3(self.fc3(self.lif2(self.fc2(self.lif1(self.fc1(x))))))


def test_layers_that_share_a_matrix_are_clipped_once_and_frozen_weights_stay(tmp_path):
    torch.manual_seed(0)
    net, path = Tied(), tmp_path / "checkpoint.safetensors"
    frozen, shared = net.fc1.weight.clone(), net.fc2.weight
    more = {**QUICK, "input_shape": (16,), "quiet": True, "checkpoint": path}
    found = sd.adapt(net, CHIP, RASTER, LABELS, **more)
    assert torch.equal(net.fc1.weight, frozen)
    assert net.fc3.weight is shared
    nodes = found.artifact.graph.nodes
    assert np.array_equal(nodes["fc2"].weight, nodes["fc3"].weight)


def test_a_network_of_which_nothing_is_trained_is_refused():
    net = Tied().requires_grad_(False)
    with pytest.raises(ConfigError, match="no number of the network is trained"):
        sd.adapt(net, CHIP, RASTER, LABELS, input_shape=(16,), quiet=True)


def test_thresholds_that_leave_their_range_go_back_to_the_best_numbers():
    torch.manual_seed(0)
    more = {**QUICK, "input_shape": (16,), "quiet": True}
    found = sd.adapt(Tied(), CHIP, RASTER, LABELS, **{**more, "rate": 1.0})
    assert found.finished
    assert found.after.rank >= found.before.rank
    with pytest.raises(RuleError, match=r"fitted before the last update.*smaller learning rate"):
        sd.adapt(Tied(), CHIP, RASTER, LABELS, **{**more, "rate": 1e30})


def test_a_chip_without_room_is_named_before_training_and_limits_off_trains(artifact):
    with pytest.raises(RuleError, match="odin"):
        sd.adapt(artifact, "odin", RASTER, LABELS, quiet=True)
    found = sd.adapt(artifact, "odin", RASTER, LABELS, limits=False, quiet=True, epochs=1)
    assert found.updates == 3


def test_a_batch_that_does_not_fit_in_memory_is_refused_from_its_size(artifact, monkeypatch):
    monkeypatch.setattr(adapting, "free_memory", lambda: 1_000_000)
    with pytest.raises(ObservationError, match=r"64 samples of 8 timesteps.*Give --batch \d+"):
        sd.adapt(artifact, CHIP, RASTER, quiet=True)


def test_a_loss_that_is_not_a_number_ends_it_with_a_smaller_rate(artifact, monkeypatch):
    forward = ChipModule.forward
    monkeypatch.setattr(
        ChipModule, "forward",
        lambda self, x: forward(self, x) * (float("nan") if torch.is_grad_enabled() else 1),
    )  # fmt: skip
    with pytest.raises(ConfigError, match=r"loss is nan in update 1.*--rate 0.0001"):
        sd.adapt(artifact, CHIP, RASTER, LABELS, quiet=True)


def test_a_network_with_codec_stays_a_policy(artifact):
    found = sd.adapt(replace(artifact, tuned=""), "loihi1", RASTER, epochs=1, quiet=True)
    assert found.artifact.codec is artifact.codec


@pytest.mark.parametrize("outputs", [1, 3])
def test_membranes_of_a_last_layer_that_does_not_spike_come_back(outputs):
    rng = np.random.default_rng(0)
    shape = {"tau": 5e-3, "r": 5.0, "v_leak": 0.0}
    nodes = {
        "input": nir.Input({"input": np.array([16])}),
        "1": nir.Linear(rng.normal(0, 0.5, (12, 16))),
        "2": nir.LIF(**{name: np.full(12, each) for name, each in shape.items()},
                     v_threshold=np.ones(12), v_reset=np.zeros(12)),
        "3": nir.Linear(rng.normal(0, 0.5, (outputs, 12))),
        "4": nir.LI(**{name: np.full(outputs, each) for name, each in shape.items()}),
        "output": nir.Output({"output": np.array([outputs])}),
    }  # fmt: skip
    edges = [("input", "1"), ("1", "2"), ("2", "3"), ("3", "4"), ("4", "output")]
    convention = Convention(1e-3, source="given")
    made = Artifact(nir.NIRGraph(nodes, edges, type_check=False), None, convention)
    found = sd.adapt(made, CHIP, RASTER, quiet=True, **QUICK)
    assert (found.before.agreement is None) == (outputs == 1)
    assert found.after.loss < found.before.loss
    if outputs == 1:
        with pytest.raises(ObservationError, match="has one output"):
            sd.adapt(made, CHIP, RASTER, LABELS * 0)


def test_a_neuron_that_the_chip_lacks_is_trained_as_the_nearest(artifact):
    late = artifact.with_convention(artifact.convention.with_options({"reset": "subtract-ahead"}))
    with warnings.catch_warnings(record=True) as seen:
        warnings.simplefilter("always")
        found = sd.adapt(late, "loihi1", RASTER, LABELS, epochs=1, quiet=True)
    assert any("nearest" in str(each.message) for each in seen)
    assert found.artifact.convention.reset in ("zero", "subtract")
