"""Run this kit's program on Loihi 1 by nengo-loihi (1.1, with nengo 4.1).

    python run_nengo_loihi.py           nengo-loihi's emulator, which is target="sim"
    python run_nengo_loihi.py --board   the hardware, target="loihi", by NxSDK (never run by us)
    python run_nengo_loihi.py --loop [ENV]  the closed loop; without ENV on recorded observations

The registers are written into blocks as they are, without nengo-loihi's discretisation. A spike of
the host or of a neuron arrives one timestep later; all neurons update in each.
"""

import sys
import warnings

from host import main, needs, np

with needs("nengo-loihi==1.1.0 and nengo==4.1.0"):
    from nengo_loihi.block import Axon, LoihiBlock, Synapse
    from nengo_loihi.builder import Model
    from nengo_loihi.inputs import SpikeInput
    from nengo_loihi.probe import LoihiProbe

KEYS = {"current": "current", "membrane": "voltage", "spikes": "spiked"}
LARGEST = 2**23 - 1  # of a membrane


class NengoChip:
    """The program as blocks, axons and probes of nengo-loihi."""

    def __init__(self, program, arguments):
        self.program, self.arguments = program, arguments
        model = Model(dt=program["dt"])
        self.input, self.t = SpikeInput(program["input"]["width"], label="input"), 0
        model.add_input(self.input)
        blocks = {layer["name"]: block(layer) for layer in program["layers"]}
        senders = {program["input"]["name"]: self.input, **blocks}
        for layer in program["layers"]:
            for synapses in layer["synapses"]:
                connect(senders[synapses["source"]], blocks[layer["name"]], synapses)
        self.probes = {}
        for name, target in blocks.items():
            model.add_block(target)
            for quantity, key in KEYS.items():
                self.probes[name, quantity] = probe = LoihiProbe(target=target, key=key)
                model.add_probe(probe)
        if arguments.board:
            from nengo_loihi.hardware.interface import HardwareInterface

            # with snips, the host sends spikes in each timestep
            self.machine = HardwareInterface(model, use_snips=True, seed=0)
            self.machine.connect()
        else:
            from nengo_loihi.emulator import EmulatorInterface

            self.machine = EmulatorInterface(model, seed=0)

    def run(self, rows):
        """Inject the rows (T, M), one in each timestep; what the probes saw after each."""
        for row in rows:
            self.t += 1  # timesteps count from 1
            self.machine.host2chip([(self.input, self.t, np.flatnonzero(row))], [])
            self.machine.run_steps(1)
        found = {name: {} for name, _ in self.probes}
        for (name, quantity), probe in self.probes.items():
            found[name][quantity] = np.array(self.machine.collect_probe_output(probe))
        return found

    def reset(self):
        """Start anew: neither the emulator nor HardwareInterface can zero states in a run."""
        self.stop()
        self.__init__(self.program, self.arguments)

    def stop(self):
        """Release the board."""
        self.machine.close()


def block(layer):
    """Neurons with the registers of a layer."""
    made = LoihiBlock(layer["neurons"], label=layer["name"])
    neurons = made.compartment
    neurons.scale_u = neurons.scale_v = False
    neurons.decay_u = np.array(layer["decay_u"], np.int32)
    neurons.decay_v = np.array(layer["decay_v"], np.int32)
    neurons.vth = np.array(layer["vth"], np.int32) << 6
    neurons.bias = np.left_shift(layer["bias_mant"], layer["bias_exp"]).astype(np.int32)
    neurons.refract_delay = np.full(layer["neurons"], layer["refractory"], np.int32)
    neurons.vmin, neurons.vmax = -LARGEST, LARGEST
    return made


def connect(sender, target, synapses):
    """Axons onto Loihi's two lists of weights: those above 0 and those below."""
    if synapses["delay"] != 1 or synapses["shift"]:
        sys.exit(f"synapses from {synapses['source']}: nengo-loihi delivers after 1 timestep alone")
    weights = np.array(synapses["weights"], np.int32) << synapses["exponent"]
    for fanout_type, part in ((2, np.maximum(weights, 0)), (3, np.minimum(weights, 0))):
        if not part.any():
            continue
        synapse = Synapse(len(part))
        synapse.indices = [np.flatnonzero(row).astype(np.int32)[None] for row in part]
        synapse.weights = [
            row[i[0]][None] << 6 for row, i in zip(part, synapse.indices, strict=True)
        ]
        synapse.format(
            compression=0, idx_bits=synapse.idx_bits(), fanout_type=fanout_type, n_synapses=63,
            weight_bits=7, weight_exp=synapses["exponent"],
        )  # fmt: skip
        target.add_synapse(synapse)
        axon = Axon(len(part))
        axon.target, axon.compartment_map = synapse, np.arange(len(part))
        sender.add_axon(axon)


if __name__ == "__main__":
    warnings.simplefilter("ignore")  # of a newer nengo, and of sums that wrap as on the chip
    sys.exit(main(NengoChip, "nengo-loihi", [("--board", "run on the hardware by NxSDK")]))
