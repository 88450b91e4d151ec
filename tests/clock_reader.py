"""A reader of sparse policies of its own, with h5py and NumPy alone, in each clock of a chip.

Nothing of spikedeploy is imported: what a .nir file of delta events, one hidden layer of CubaLIF
neurons, a skip and a readout of LI neurons does was written down once more, from the file's fields
and these definitions. One control step is one row of events.

    gated      each layer updates once, first the hidden one; events and spikes act at once
    pipelined  each layer updates once; events and spikes act in the next timestep
    free       each layer updates in three timesteps; events are injected in the first, the
               membranes of the readout are read in the last. Events reach the hidden layer, and
               spikes the readout, in the next timestep; events past the hidden layer one later
"""

from dataclasses import dataclass, field
from pathlib import Path

import h5py
import numpy as np

# clock -> timesteps of a control step; delays [timesteps] of events onto the hidden layer, of
# events onto the readout, and of spikes onto the readout
CLOCKS = {"gated": (1, 0, 0, 0), "pipelined": (1, 1, 1, 1), "free": (3, 1, 2, 1)}


@dataclass
class Neurons:
    """A layer: u = a u + x, v = b v + u + leak, a spike and v = 0 where v > threshold.

    current_decay, membrane_decay: (N,) a and b; in integers of 4096, products rounded toward 0.
    leak, threshold: (N,).
    """

    current_decay: np.ndarray
    membrane_decay: np.ndarray
    leak: np.ndarray
    threshold: np.ndarray
    current: np.ndarray = field(init=False)
    membrane: np.ndarray = field(init=False)

    def __post_init__(self):
        self.current = np.zeros_like(self.leak)
        self.membrane = np.zeros_like(self.leak)

    def advance(self, arriving):
        """Spikes (N,) of a timestep in which this arrives."""
        self.current = kept(self.current, self.current_decay) + arriving
        self.membrane = kept(self.membrane, self.membrane_decay) + self.current + self.leak
        spikes = self.membrane > self.threshold
        self.membrane[spikes] = 0
        return spikes


def kept(state, factor):
    """What a timestep leaves of a state."""
    if state.dtype.kind == "f":
        return state * factor
    return np.sign(state) * (np.abs(state) * factor >> 12)


@dataclass
class Network:
    """Synapses and neurons between events and actions.

    hidden, skip, onward: (N, M) weights of events onto the hidden layer, of events and of spikes
        onto the readout.
    action, offset: (act, readouts) and (act,), of membranes in units of `scale`.
    """

    hidden: np.ndarray
    skip: np.ndarray
    onward: np.ndarray
    lif: Neurons
    readout: Neurons
    action: np.ndarray
    offset: np.ndarray
    scale: np.ndarray | float = 1.0


class ClockedPolicy:
    """A policy that acts in one of CLOCKS.

    spikes: of the hidden layer, a row for each timestep so far.
    events: (M,) of the last control step.
    """

    def __init__(self, path: Path, clock: str, network: Network | None = None):
        """Read a file; a network in other numbers may take the place of the file's."""
        with h5py.File(path) as file:
            self._codec = read_codec(file["node/metadata/spikedeploy/codec"])
            self._network = network or read_network(file["node"])
        self._clock = CLOCKS[clock]
        self._sent = np.zeros(len(self._codec["step"]), np.int64)
        self._injected: list[np.ndarray] = []
        self.spikes: list[np.ndarray] = []

    def act(self, observation):
        """Action (act,) for an observation (obs,)."""
        network = self._network
        timesteps, *_ = self._clock
        self.events = self._encode(np.asarray(observation, np.float64))
        for step in range(timesteps):
            self._injected.append(self.events if step == 0 else np.zeros_like(self.events))
            self._timestep()
        return np.tanh(network.action @ (network.readout.membrane * network.scale) + network.offset)

    def _timestep(self):
        _, onto_hidden, past_hidden, onto_readout = self._clock
        network = self._network
        arriving = network.hidden @ late(self._injected, onto_hidden, network.hidden)
        self.spikes.append(network.lif.advance(arriving))
        network.readout.advance(
            network.onward @ late(self.spikes, onto_readout, network.onward)
            + network.skip @ late(self._injected, past_hidden, network.skip)
        )

    def _encode(self, observation):
        """Events (M,) of what has moved by more than the threshold since the last events."""
        codec, most = self._codec, int(self._codec["most"])
        x = (observation - codec["mean"]) / codec["std"]
        x = x.clip(-codec["clip"], codec["clip"])
        apart = np.rint(256 * (x / codec["step"])).astype(np.int64) - 256 * self._sent
        events = np.minimum((np.abs(apart) + 128) // 256, most) * np.sign(apart)
        events[np.abs(apart) <= codec["threshold"]] = 0
        self._sent += events
        rows = np.zeros((len(events), 2, most), np.int64)
        for channel, count in enumerate(events):
            if count:
                first = 0 if codec["code"] == b"unary" else abs(count) - 1
                rows[channel, int(count < 0), first : abs(count)] = 1
        return rows.ravel()


def late(rows, delay, weights):
    """The row of some timesteps ago, in the numbers of the weights; nothing before the first."""
    row = rows[-1 - delay] if len(rows) > delay else np.zeros(weights.shape[1])
    return row.astype(weights.dtype)


def read_codec(group):
    """Fields of the normaliser and of the encoder."""
    return {
        name: each[()] for part in ("normaliser", "encoder") for name, each in group[part].items()
    }


def read_network(group):
    """The nodes of the graph in float64, by forward Euler with the file's dt."""
    nodes = {
        name: {key: each[()] for key, each in node.items()} for name, node in group["nodes"].items()
    }
    dt = group["metadata/spikedeploy/convention/dt"][()]
    lif, readout, action = nodes["lif1"], nodes["readout"], nodes["action"]
    # v' = (v_leak - v + r u) / tau_mem, u' = (w_in x - u) / tau_syn
    hidden_gain = lif["w_in"] * dt / lif["tau_syn"] * lif["r"] * dt / lif["tau_mem"]
    readout_gain = readout["r"] * dt / readout["tau"]
    return Network(
        hidden=nodes["fc1"]["weight"] * hidden_gain[:, None],
        skip=nodes["skip"]["weight"] * readout_gain[:, None],
        onward=nodes["fc2"]["weight"] * readout_gain[:, None],
        lif=Neurons(
            1 - dt / lif["tau_syn"],
            1 - dt / lif["tau_mem"],
            lif["v_leak"] * dt / lif["tau_mem"],
            lif["v_threshold"],
        ),
        readout=Neurons(
            np.zeros_like(readout_gain),
            1 - dt / readout["tau"],
            readout["v_leak"] * dt / readout["tau"],
            np.full_like(readout_gain, np.inf),
        ),
        action=action["weight"].astype(np.float64),
        offset=action["bias"],
    )
