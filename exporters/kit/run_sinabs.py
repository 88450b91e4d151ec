"""Run this kit's program for Speck by sinabs (3.1): its layers offline, or the chip by samna.

    python run_sinabs.py                sinabs' layers; `import sinabs` loads no samna
    python run_sinabs.py --board        a Speck 2f dev kit, by sinabs' DynapcnnNetwork and samna
                                        (never run by us)
    python run_sinabs.py --loop [ENV]   the closed loop; without ENV on recorded observations

The layers are stepped in time: all spikes of a timestep are one sum, and a neuron spikes as often
as its threshold fits into its membrane, or once. The chip has no timesteps and takes one event
after another, so that counts of a board may differ where events of both signs meet in a timestep.
"""

import sys

from host import main, needs, np

with needs("sinabs==3.1.3 by pip install --no-deps, and torch"):
    import sinabs.layers
    import torch
    from sinabs.activation import MembraneReset, MembraneSubtract, MultiSpike, SingleSpike


class SinabsChip:
    """A chain of Linear and IAF layers with the program's integers."""

    def __init__(self, program, arguments):
        if len(program["layers"]) > 9:
            sys.exit("Speck has nine cores, and each holds one layer")
        self.program, self.parts = program, []
        before = program["input"]["name"]
        for layer in program["layers"]:
            if [s["source"] for s in layer["synapses"]] != [before]:
                sys.exit(f"layer {layer['name']}: this script runs chains, without skips and loops")
            self.parts += [linear(layer), neurons(layer, program)]
            before = layer["name"]
        self.board = board(self.parts, program) if arguments.board else None

    def run(self, rows):
        """Spike counts (T, M) in, membranes and counts after each timestep out."""
        names = [layer["name"] for layer in self.program["layers"]]
        if self.board is not None:
            size = self.program["layers"][-1]["neurons"]
            return {names[-1]: {"spikes": events_of(self.board, rows, size)}}
        found = {name: {"membrane": [], "spikes": []} for name in names}
        with torch.no_grad():
            parts = list(zip(names, self.parts[::2], self.parts[1::2], strict=True))
            for row in rows:
                spikes = torch.tensor(row).float()[None, None]
                for name, weights, layer in parts:
                    spikes = layer(weights(spikes))
                    found[name]["spikes"].append(spikes[0, 0].numpy())
                    found[name]["membrane"].append(layer.v_mem[0].numpy().copy())
        return {name: {q: np.array(r) for q, r in each.items()} for name, each in found.items()}

    def reset(self):
        """Zero the membranes by reset_states, of sinabs' layers or of its DynapcnnNetwork.

        The latter writes zeros into the membranes of the chip by samna, and sleeps more than 1 s.
        """
        for each in self.parts[1::2] if self.board is None else [self.board]:
            each.reset_states()

    def stop(self):
        """Do nothing: there is no hardware to release."""


def linear(layer):
    """The weights and biases of a layer: Speck's kernels."""
    (synapses,) = layer["synapses"]
    weights = np.array(synapses["weights"], float) * 2.0 ** synapses["exponent"]
    made = torch.nn.Linear(*weights.shape)
    made.weight.data = torch.tensor(weights.T).float().contiguous()
    made.bias.data = torch.tensor(layer["bias"]).float()
    return made


def neurons(layer, program):
    """Neurons that add up, with the lower threshold of the program."""
    floors = {"zero": 0.0, "threshold": -float(layer["threshold"][0]), "none": -(2.0**15)}
    if len(set(layer["threshold"])) > 1:
        sys.exit(f"layer {layer['name']}: neurons of a core share one threshold")
    return sinabs.layers.IAF(
        spike_threshold=torch.tensor(float(layer["threshold"][0])),
        spike_fn=MultiSpike if program["spikes"] == "many" else SingleSpike,
        reset_fn=MembraneSubtract() if program["reset"] == "subtract" else MembraneReset(),
        min_v_mem=floors[program["floor"]],
    )


def board(parts, program):
    """The chain on a dev kit. Importing this back-end imports samna, which installs itself."""
    from sinabs.backend.dynapcnn import DynapcnnNetwork

    squeezed = []
    for weights, layer in zip(parts[::2], parts[1::2], strict=True):
        # each layer is a convolution over a single pixel
        kernel = torch.nn.Conv2d(weights.in_features, weights.out_features, 1)
        kernel.weight.data = weights.weight.data.float()[:, :, None, None]
        kernel.bias.data = weights.bias.data.float()
        squeezed += [kernel, sinabs.layers.IAFSqueeze(
            spike_threshold=layer.spike_threshold, spike_fn=layer.spike_fn, reset_fn=layer.reset_fn,
            min_v_mem=float(layer.min_v_mem), batch_size=1,
        )]  # fmt: skip
    network = DynapcnnNetwork(
        torch.nn.Sequential(*squeezed), (program["input"]["width"], 1, 1), discretize=False
    )
    network.to("speck2fdevkit:0", monitor_layers=[-1])
    return network


def events_of(network, rows, size):
    """Counts (T, N) of the events that leave the chip, a millisecond of its time for each row."""
    from sinabs.backend.dynapcnn.chip_factory import ChipFactory

    factory = ChipFactory("speck2fdevkit:0")
    raster = torch.tensor(rows)[:, :, None, None]
    seen = network(factory.raster_to_events(raster, layer=network.layer2core_map[0], dt=1e-3))
    counts = np.zeros((len(rows), size), int)
    start = min((event.timestamp for event in seen), default=0)
    for event in seen:
        row = min((event.timestamp - start) // 1000, len(rows) - 1)
        counts[row, event.feature] += 1
    return counts


if __name__ == "__main__":
    sys.exit(main(SinabsChip, "sinabs", [("--board", "run on a Speck 2f dev kit")]))
