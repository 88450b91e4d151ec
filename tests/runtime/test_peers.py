"""The presets against the tools themselves, where they are installed.

`./spike test --peers` installs Norse, SpikingJelly and Nengo. sinabs 3.1.3 and rockpool 3.1.0 pin a
nir of their own and come with `pip install --no-deps`, without samna, whose import runs an
installer. Nengo's pytest plugin is older than pytest, which pyproject.toml tells to leave it out.
"""

from importlib.util import find_spec
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory

import nir
import numpy as np
import pytest

from spikedeploy.runtime.artifact.artifact import load
from spikedeploy.runtime.float_model import FloatGraph
from tests.networks import chain, cuba, lif

pytestmark = pytest.mark.filterwarnings("ignore")
TIMESTEPS = 400


def installed(module):
    """The tool, or a skipped test; tools warn of each other when they are imported."""
    reason = f"{module} is not installed; ./spike test --peers compares with most tools"
    return pytest.importorskip(module, reason=reason, exc_type=ImportError)


def installed_without_samna(module):
    """A tool of those that import samna where it is installed."""
    if find_spec("samna"):
        pytest.skip("samna is installed, whose import runs an installer")
    return installed(module)


def single(node):
    """The node in float32, as tools write it."""
    for name, value in vars(node).items():
        if isinstance(value, np.ndarray):
            setattr(node, name, value.astype(np.float32))
    return node


def network(neurons, gain=1.0, sizes=(20, 32, 8), recurrent=False):
    """Two layers of random weights and biases: 20 -> 32 -> 8."""
    rng = np.random.default_rng(0)
    nodes = []
    for fan_in, size in pairwise(sizes):
        weight = 2 * gain * rng.normal(size=(size, fan_in)) / fan_in**0.5
        bias = 0.1 * rng.normal(size=size)
        nodes += [single(nir.Affine(weight, bias)), single(neurons(size))]
    whole = chain(*nodes, width=sizes[0], act=sizes[-1])
    if recurrent:
        weight = rng.normal(size=(sizes[1], sizes[1])) / sizes[1] ** 0.5
        nodes = {**whole.nodes, "n2_rec": single(nir.Linear(weight))}
        edges = [*whole.edges, ("n2", "n2_rec"), ("n2_rec", "n2")]
        # nirtorch takes what stands last for the output
        whole = nir.NIRGraph(dict(sorted(nodes.items())), sorted(edges))
    return whole


def raster():
    rng = np.random.default_rng(1)
    return (rng.random((1, TIMESTEPS, 20)) < 0.25).astype(np.float32)


def same(tool, whole, wanted, **given):
    """No spike of 3200 differs between the tool and its file, and there are some."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "foreign.nir"
        nir.write(path, whole)
        found = FloatGraph(load(path, like=tool, **given)).run(raster())["output"][0]
    assert np.count_nonzero(found != np.round(wanted, 6)) == 0
    assert found.size == 3200
    assert 100 < np.count_nonzero(found) < 3000


def current_based(size):
    return cuba(size, alpha=0.8, beta=0.9, dt=1e-4, threshold=1.0)


def physical(size):
    """r = 1 and w_in = 1: the gains of a tool that leaves dt out of them."""
    full = [np.full(size, value) for value in (5e-3, 10e-3, 1.0, 0.0, 1.0)]
    return nir.CubaLIF(*full, w_in=np.ones(size))


def in_steps(model):
    """Output of a torch module that hands its state on."""
    import torch

    state, outputs = None, []
    with torch.no_grad():
        for row in torch.from_numpy(raster()[0]):
            output, state = model(row[None], state)
            outputs.append(output[0].numpy())
    return np.array(outputs)


NORSE = {
    "CubaLIF": (current_based, 1, False, {"dt": 1e-4}),
    "CubaLIF-physical": (physical, 50, False, {}),
    "CubaLIF-subtract": (current_based, 1, False, {"dt": 1e-4, "reset": "subtract"}),
    "recurrent": (current_based, 1, True, {"dt": 1e-4}),
    "recurrent-subtract": (current_based, 1, True, {"dt": 1e-4, "reset": "subtract"}),
    "LIF": (lambda n: lif(n, tau=1e-3, r=10.0), 10, False, {"dt": 1e-4}),
    "IF": (lambda n: nir.IF(np.ones(n), np.ones(n)), 1, False, {}),
}


@pytest.mark.parametrize("case", NORSE)
def test_norse_reads_the_same(case):
    norse = installed("norse.torch")
    from norse.torch.functional import reset

    neurons, gain, recurrent, given = NORSE[case]
    whole = network(neurons, gain, recurrent=recurrent)
    method = reset.reset_subtract if "reset" in given else reset.reset_value
    model = norse.from_nir(whole, reset_method=method, dt=given.get("dt", 1e-3))
    same("norse", whole, in_steps(model), **given)


SPIKINGJELLY = {
    "CubaLIF": (current_based, 1, False),
    "recurrent": (current_based, 1, True),
    "LIF": (lambda n: lif(n, tau=1e-3, r=10.0), 1, False),
    "LIF-physical": (lambda n: lif(n, tau=1e-3, r=1.0), 10, False),
    "IF": (lambda n: nir.IF(np.full(n, 1e4), np.ones(n)), 1, False),
}


@pytest.mark.parametrize("case", SPIKINGJELLY)
def test_spikingjelly_reads_the_same(case):
    exchange = installed("spikingjelly.activation_based.nir_exchange.from_nir")
    neurons, gain, recurrent = SPIKINGJELLY[case]
    whole = network(neurons, gain, recurrent=recurrent)
    same("spikingjelly", whole, in_steps(exchange.import_from_nir(whole, dt=1e-4)))


SNNTORCH = {
    "CubaLIF": (current_based, 1),
    "LIF": (lambda n: lif(n, tau=1e-3, r=10.0), 1),
    "LIF-physical": (lambda n: lif(n, tau=1e-3, r=1.0), 10),
}


@pytest.mark.parametrize("case", SNNTORCH)
def test_snntorch_computes_the_same(case):
    """Its neurons, with the arguments that its import passes; that import needs nirtorch."""
    snn, torch = installed("snntorch"), installed("torch")
    neurons, gain = SNNTORCH[case]
    whole = network(neurons, gain)
    x = torch.from_numpy(raster()[0])
    with torch.no_grad():
        for affine, name in (("n1", "n2"), ("n3", "n4")):
            node, fc = whole.nodes[name], whole.nodes[affine]
            drive = x @ torch.from_numpy(fc.weight.T) + torch.from_numpy(fc.bias)
            x = snntorch_layer(snn, torch, node, drive)
    same("snntorch", whole, x.numpy())


def snntorch_layer(snn, torch, node, drive):
    """Spikes (T, N) of a layer."""
    options = {"reset_mechanism": "zero", "reset_delay": False}
    if isinstance(node, nir.CubaLIF):
        decays = [float(1 - 1e-4 / tau[0]) for tau in (node.tau_syn, node.tau_mem)]
        cell = snn.Synaptic(*decays, threshold=float(node.v_threshold[0]), **options)
        state = cell.init_synaptic()
    else:
        scale = float((node.r * 1e-4 / node.tau)[0])
        beta = torch.from_numpy(1 - 1e-4 / node.tau)
        cell = snn.Leaky(beta=beta, threshold=float(node.v_threshold[0]) / scale, **options)
        state = (cell.init_leaky(),)
    rows = []
    for row in drive:
        spikes, *state = cell(row, *state)
        rows.append(spikes)
    return torch.stack(rows)


SINABS = {
    "LIF": lambda n: lif(n, tau=12.0, r=10.0),
    "IF": lambda n: nir.IF(np.ones(n), np.ones(n)),
}


@pytest.mark.parametrize("case", SINABS)
def test_sinabs_reads_the_same(case):
    """Node by node: its import pins a nir that cannot open files with v_reset."""
    sinabs, torch = installed_without_samna("sinabs.nir"), installed("torch")
    whole = network(SINABS[case])
    x = torch.from_numpy(raster()[0])
    with torch.no_grad():
        for name in ("n1", "n2", "n3", "n4"):
            node = whole.nodes[name]
            x = sinabs._import_sinabs_module(node, batch_size=1, num_timesteps=None)(x)
    same("sinabs", whole, x.numpy())


def leaking(size):
    full = [np.full(size, value) for value in (5e-3, 10e-3, 9.0, 0.01, 1.0)]
    return nir.CubaLIF(*full, w_in=np.ones(size))


@pytest.mark.parametrize(("neurons", "gain"), [(current_based, 0.3), (leaking, 0.2)])
def test_rockpool_reads_the_same(neurons, gain):
    """Node by node: its import pins a nir that cannot open files with v_reset."""
    rockpool = installed_without_samna("rockpool.nn.modules.torch.nir")
    torch = installed("torch")
    whole = network(neurons, gain)
    x = torch.from_numpy(raster())
    with torch.no_grad():
        for name in ("n1", "n2", "n3", "n4"):
            x, _, _ = rockpool._convert_nir_to_rockpool(whole.nodes[name])(x)
    same("rockpool", whole, x[0].numpy())


NENGO = {
    "LIF": (lambda n: lif(n, tau=1e-2, r=1.0), 10),
    "CubaLIF": (
        lambda n: nir.CubaLIF(
            *[np.full(n, v) for v in (4e-3, 8e-3, 2.0, 0.0, 1.0)], w_in=np.ones(n)
        ),
        4,
    ),
}


@pytest.mark.parametrize("case", NENGO)
def test_nengo_computes_the_same(case):
    """Its neurons and synapses, set as the NIR paper's import sets them."""
    nengo = installed("nengo")
    neurons, gain = NENGO[case]
    whole = network(neurons, gain, sizes=(20, 8) if case == "LIF" else (20, 32, 8))
    dt, made, synapses = 1e-3, {}, {}
    with nengo.Network() as model:
        for name, node in whole.nodes.items():
            made[name] = nengo_node(nengo, node, dt)
            if isinstance(node, nir.CubaLIF):
                synapses[name] = nengo.synapses.Lowpass(-dt / np.log(1 - dt / node.tau_syn[0]))
        for source, target in whole.edges:
            nengo.Connection(made[source], made[target], synapse=synapses.get(target))
        played = nengo.Node(nengo.processes.PresentInput(raster()[0], presentation_time=dt))
        nengo.Connection(played, made["input"], synapse=None)
        probe = nengo.Probe(made["output"])
    with nengo.Simulator(model, dt, progress_bar=False) as simulator:
        simulator.run_steps(TIMESTEPS)
    same("nengo", whole, simulator.data[probe], dt=dt)


def nengo_node(nengo, node, dt):
    if isinstance(node, nir.Affine):
        size = {"size_in": node.weight.shape[1], "size_out": node.weight.shape[0]}
        return nengo.Node(lambda _, x: node.weight @ x + node.bias, **size)
    if isinstance(node, (nir.Input, nir.Output)):
        return nengo.Node(None, size_in=int(node.input_type["input"][0]))
    size = node.r.size
    still = {"voltage": nengo.dists.Choice([0])}
    if isinstance(node, nir.LIF):
        cell = nengo.LIF(tau_rc=float(node.tau[0]), tau_ref=0, initial_state=still)
        gain = 1 / node.v_threshold
    else:
        tau = float(node.tau_mem[0])
        cell = nengo.LIF(tau_rc=tau, tau_ref=0, amplitude=dt, initial_state=still)
        gain = node.w_in * node.r / node.v_threshold
    ensemble = nengo.Ensemble(size, 1, neuron_type=cell, gain=gain, bias=np.zeros(size))
    return ensemble.neurons
