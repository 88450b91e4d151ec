"""Spikes, synaptic operations and actions of a policy file on a recorded episode, recounted.

    python recount.py policy.nir rollout.npz out.npz

Written from docs/codec.md and docs/evidence.md with h5py and NumPy alone: nothing of spikedeploy
is used, so that what the toolchain counts can be checked by something that shares no line with it.
It reads graphs of Affine, Linear, Conv2d, Flatten, LIF, CubaLIF, IF, LI, CubaLI and I, with loops
where the clock is pipelined, and the codes "population", "rate" (regular), "delta" and "events"
(channels). out.npz holds "action" (S, act) or (S,), "spikes/NAME" (S,) of the input and of every
spiking node, and "sops/NAME" (S,) of the synapses into every node of neurons.
"""

import sys

import h5py
import numpy as np


def plain(tree):
    """A group of HDF5 as nested dicts of arrays, numbers and texts."""
    if isinstance(tree, h5py.Group):
        return {name: plain(each) for name, each in tree.items()}
    value = tree[()]
    return value.decode() if isinstance(value, bytes) else value


class Population:
    """Integrate-and-fire neurons on the constant drive of a Gaussian receptive field."""

    def __init__(self, fields, timesteps):
        self.fields, self.timesteps = fields, timesteps

    def spikes(self, x):
        """(T, M) of the normalised observation x (obs,)."""
        mean, std, threshold = (self.fields[name] for name in ("mean", "std", "threshold"))
        drive = np.exp(-0.5 * ((x[:, None] - mean) / std) ** 2).ravel()
        membrane, rows = np.zeros(drive.size), []
        for _ in range(self.timesteps):
            membrane = membrane + drive
            rows.append(membrane > threshold)
            membrane = membrane - threshold * rows[-1]
        return np.array(rows, float)


class Rate:
    """An 8-bit accumulator for each number, which begins half full."""

    def __init__(self, fields, timesteps):
        if fields["mode"] != "regular":
            sys.exit(f"rates of mode {fields['mode']} are not recounted")
        self.fields, self.timesteps = fields, timesteps

    def spikes(self, x):
        """(T, M) of the normalised observation x (obs,)."""
        low, high = self.fields["low"], self.fields["high"]
        n = np.rint(256 * np.clip((x - low) / (high - low), 0, 1)).astype(int)
        t = np.arange(self.timesteps + 1)[:, None]
        return np.diff((t * n + 128) // 256, axis=0).astype(float)


class Delta:
    """Signed events where a number has moved from the level q that was sent."""

    def __init__(self, fields, timesteps):
        self.fields, self.timesteps = fields, timesteps
        self.q = [0] * len(fields["step"])

    def spikes(self, x):
        """(T, M) of the normalised observation x (obs,)."""
        most, rows = int(self.fields["most"]), []
        for _ in range(self.timesteps):
            row = np.zeros((len(x), 2, most))
            for i, (number, step) in enumerate(zip(x, self.fields["step"], strict=True)):
                n = self.events(0 if np.isinf(step) else 256 * number / step, self.q[i], most)
                self.q[i] += n
                if n:
                    first = 1 if self.fields["code"] == "unary" else abs(n)
                    row[i, int(n < 0), first - 1 : abs(n)] = 1
            rows.append(row.ravel())
        return np.array(rows)

    def events(self, parts, q, most):
        """Signed number n of events."""
        e = int(min(max(round(parts), -(2**30)), 2**30)) - 256 * q
        if abs(e) <= self.fields["threshold"]:
            return 0
        return (1 if e > 0 else -1) * min((abs(e) + 128) // 256, most)


class Events:
    """Counts of an event camera, K channels a polarity."""

    def __init__(self, fields, timesteps):
        if fields["code"] != "channels":
            sys.exit(f"events of code {fields['code']} are not recounted")
        self.fields, self.timesteps = fields, timesteps

    def spikes(self, x):
        """(T, M) of the normalised observation x (obs,)."""
        counts = np.floor(x).reshape(int(self.fields["polarities"]), 1, -1)
        raster = np.zeros((self.timesteps, x.size * int(self.fields["most"])))
        raster[0] = (counts >= np.arange(1, self.fields["most"] + 1)[:, None]).ravel()
        return raster


CODES = {"population": Population, "rate": Rate, "delta": Delta, "events": Events}


def convolve(node, weight, maps):
    """Output (O, Y, X) of a kernel (O, I / groups, ky, kx) over maps (I, Y, X)."""
    padding, stride, dilation = (np.broadcast_to(node[n], 2) for n in GEOMETRY)
    padded = np.pad(maps, [(0, 0), *((side, side) for side in padding)])
    extents = np.array(padded.shape[1:]) - dilation * (np.array(weight.shape[2:]) - 1)
    ends = (extents - 1) // stride * stride + 1
    groups = np.split(padded, node["groups"]), np.split(weight, node["groups"])
    grouped = zip(*groups, strict=True)
    return np.concatenate([part(*each, stride, dilation, ends) for each in grouped])


def part(maps, weight, stride, dilation, ends):
    """Output of one group of channels."""
    total = 0
    for at in np.ndindex(weight.shape[2:]):
        (y, x), (below, right) = at * dilation, at * dilation + ends
        seen = maps[:, y : below : stride[0], x : right : stride[1]]
        total = total + np.einsum("oi,iyx->oyx", weight[:, :, at[0], at[1]], seen)
    return total


GEOMETRY = ("padding", "stride", "dilation")


def decay(tau, convention):
    """Decay factor of one timestep."""
    step = convention["dt"] / tau
    return np.exp(-step) if convention["integrator"] == "exponential" else 1 - step


class Neurons:
    """A node of neurons; without a threshold its membranes are its output."""

    def __init__(self, node, convention):
        kind = node["type"]
        self.subtract = convention["reset"] == "subtract"
        # timesteps from a spike to where it acts
        self.delay = int(convention.get("clock") == "pipelined")
        self.a, self.leak, gain = None, 0.0, node["r"]
        if kind in ("IF", "I"):
            self.b, gain = np.ones(gain.shape), convention["dt"] * gain
        else:
            self.b = decay(node["tau_mem" if "Cuba" in kind else "tau"], convention)
            self.leak, gain = (1 - self.b) * node["v_leak"], (1 - self.b) * gain
        if "Cuba" in kind:
            self.a = decay(node["tau_syn"], convention)
            gain = (1 - self.a) * node["w_in"] * gain
        self.gain = np.where(np.abs(gain - 1) <= 1e-9, 1.0, gain)
        self.threshold, self.v_reset = node.get("v_threshold"), node.get("v_reset", 0.0)
        # what arrives in the first timestep of a pipeline: biases
        self.constant = np.zeros(self.gain.shape)
        self.reset()

    def reset(self):
        """Currents and membranes of 0."""
        self.current, self.membrane = np.zeros(self.gain.shape), np.zeros(self.gain.shape)
        self.arriving = [self.constant] * self.delay

    def step(self, x):
        """Spikes or membranes (N,) of the next timestep."""
        drive = self.gain * x
        self.current = drive if self.a is None else self.a * self.current + drive
        self.membrane = self.b * self.membrane + self.current + self.leak
        if self.threshold is None:
            return self.membrane
        spikes = self.membrane > self.threshold
        back = self.membrane - (self.threshold - self.v_reset) if self.subtract else self.v_reset
        self.membrane = np.where(spikes, back, self.membrane)
        return spikes.astype(float)


class SigmaDelta(Neurons):
    """An I that rectifies, and sends changes in whole numbers of thresholds."""

    def __init__(self, node, convention, stated):
        super().__init__(node, convention)
        self.theta, self.bias = stated["threshold"], stated["bias"]

    def reset(self):
        """Nothing has arrived or been sent."""
        super().reset()
        self.sent = np.zeros(self.gain.shape)

    def step(self, x):
        """Graded spikes (N,) of the next timestep."""
        apart = np.maximum(super().step(x) + self.bias, 0) / self.theta - self.sent
        far = np.abs(apart)
        graded = np.where(far >= 1, np.sign(apart) * np.floor(far + 0.5), 0)
        self.sent = self.sent + graded
        return graded


class Policy:
    """A policy file."""

    def __init__(self, path):
        with h5py.File(path) as file:
            tree = plain(file["node"])
        known = tree["metadata"]["spikedeploy"]
        self.codec, self.convention = known["codec"], known["convention"]
        if self.convention["delay"] or {"spikes", "floor"} & self.convention.keys():
            sys.exit("only delays of the clock, at most one spike above the threshold, no floor")
        self.nodes = tree["nodes"]
        edges = [(a.decode(), b.decode()) for a, b in tree["edges"]]
        self.sources = {name: [a for a, b in edges if b == name] for name in self.nodes}
        self.neurons = {
            name: Neurons(node, self.convention) for name, node in self.nodes.items() if "r" in node
        }
        graded = known.get("sigma_delta", {})
        for name, stated in graded.items():
            self.neurons[name] = SigmaDelta(self.nodes[name], self.convention, stated)
        for name, layer in self.neurons.items():
            for bias in (self.nodes[s].get("bias", 0.0) for s in self.sources[name]):
                over_places = (1,) * (layer.gain.ndim - np.ndim(bias))  # of a kernel: by channel
                layer.constant = layer.constant + np.reshape(bias, np.shape(bias) + over_places)
            layer.reset()
        self.order = self.sorted()
        self.spiking = [
            n for n, layer in self.neurons.items() if layer.threshold is not None or n in graded
        ]
        self.input, self.output = (
            next(name for name, node in self.nodes.items() if node["type"] == kind)
            for kind in ("Input", "Output")
        )

    def sorted(self):
        """Names of the nodes, each after its sources."""
        order = []
        while len(order) < len(self.nodes):
            ready = [
                name
                for name in self.nodes
                if name not in order
                and (self.delays(name) or all(source in order for source in self.sources[name]))
            ]
            if not ready:
                sys.exit("loops only where the clock is pipelined")
            order += ready
        return order

    def delays(self, name):
        """Whether what a node receives acts a timestep later."""
        return name in self.neurons and self.neurons[name].delay > 0

    def play(self, observations):
        """Actions, spikes and SOPs of every control step."""
        encoder = self.codec["encoder"]
        code = CODES[encoder["kind"]](encoder, int(self.codec["timesteps"]))
        found = [self.infer(code.spikes(self.normalised(row))) for row in observations]
        return {name: np.array([each[name] for each in found]) for name in found[0]}

    def normalised(self, observation):
        """x (obs,)."""
        n = self.codec["normaliser"]
        return np.clip((observation - n["mean"]) / n["std"], -n["clip"], n["clip"])

    def infer(self, raster):
        """What one inference counts and puts out."""
        if self.convention["state"] == "reset":
            for layer in self.neurons.values():
                layer.reset()
        counts = {f"spikes/{name}": 0 for name in (self.input, *self.spiking)}
        counts |= {f"sops/{name}": 0 for name in self.neurons}
        outputs = []
        for row in raster:
            values = self.step(row)
            for name in (self.input, *self.spiking):
                counts[f"spikes/{name}"] += int(np.count_nonzero(values[name]))
            for name in self.neurons:
                counts[f"sops/{name}"] += self.operations(name, values)
            outputs.append(values[self.output])
        return {**counts, "action": self.action(np.mean(outputs, axis=0))}

    def step(self, row):
        """Output (N,) of every node in one timestep."""
        values = {self.input: row.reshape(self.nodes[self.input]["shape"])}
        for name in self.order:
            if name == self.input:
                continue
            node = self.nodes[name]
            if self.delays(name):
                values[name] = self.neurons[name].step(self.neurons[name].arriving.pop(0))
                continue
            x = sum(values[source] for source in self.sources[name])
            if name in self.neurons:
                values[name] = self.neurons[name].step(x)
            elif node["type"] in ("Affine", "Linear"):
                values[name] = node["weight"] @ x + node.get("bias", 0.0)
            elif node["type"] == "Conv2d":
                values[name] = convolve(node, node["weight"], x) + node["bias"][:, None, None]
            elif node["type"] == "Flatten":
                values[name] = x.ravel()
            elif node["type"] == "Output":
                values[name] = x
            else:
                sys.exit(f"node {name}: {node['type']} is not recounted")
        for name in filter(self.delays, self.neurons):
            arrives = sum(values[source] for source in self.sources[name])
            self.neurons[name].arriving.append(arrives)
        return values

    def operations(self, name, values):
        """Spikes times non-zero fan-out, over all weights into a node of neurons."""
        total = 0
        for weights in self.sources[name]:
            node = self.nodes[weights]
            there = (node["weight"] != 0).astype(int)
            for source in self.sources[weights]:
                sent = (values[source] != 0).astype(int)
                one = convolve(node, there, sent) if node["type"] == "Conv2d" else there @ sent
                total += int(one.sum())
        return total

    def action(self, score):
        """The action of a mean readout (act,)."""
        if self.codec["squash"] == "argmax":
            return int(np.argmax(score))
        return np.tanh(score) if self.codec["squash"] == "tanh" else score


if __name__ == "__main__":
    policy, rollout, out = sys.argv[1:]
    with np.load(rollout) as played:
        observations = played["observation"][:-1]
    np.savez(out, **Policy(policy).play(observations))
