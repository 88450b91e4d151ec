"""Run this kit's program on Loihi 1 or 2 by lava (lava-nc 0.10, Python 3.10).

    python run_lava.py                  lava's simulator of the fixed-point neurons
    python run_lava.py --board          Loihi 2, where Intel's lava-loihi is; never run by us
    python run_lava.py --loop           the actions, from the recorded observations
    python run_lava.py --loop ENV       the closed loop in a gymnasium environment

Every process advances once in each timestep, and a Dense delivers one timestep after a spike.
"""

import sys

from host import main, needs, np

with needs("lava-nc==0.10.0, with Python 3.10"):
    from lava.magma.core import run_configs
    from lava.magma.core.run_conditions import RunSteps
    from lava.proc.dense.process import DelayDense, Dense
    from lava.proc.io.sink import RingBuffer as Sink
    from lava.proc.io.source import RingBuffer as Source
    from lava.proc.lif.process import LIF
    from lava.utils.weightutils import SignMode


class LavaChip:
    """The program's neurons and connections as lava's processes."""

    def __init__(self, program, arguments):
        self.program, self.arguments = program, arguments
        # lava-loihi is for Loihi 2, whose default neuron is that of lava's Loihi 1
        simulated = "Loihi2SimCfg" if program["chip"] == "loihi2" else "Loihi1SimCfg"
        name = "Loihi2HwCfg" if arguments.board else simulated
        self.config = getattr(run_configs, name)(select_tag="fixed_pt")
        width = program["input"]["width"]
        self.source = Source(data=np.zeros((width, 1), np.int32))
        port = through(self.source.s_out, "PyToNxAdapter", arguments.board)
        self.layers = {layer["name"]: neurons(layer) for layer in program["layers"]}
        self.sinks, self.kept = {}, []  # lava does not keep processes alive
        for layer in program["layers"]:
            target = self.layers[layer["name"]]
            for synapses in layer["synapses"]:
                inside = synapses["source"] != program["input"]["name"]
                sender = self.layers[synapses["source"]].s_out if inside else port
                for dense in connections(synapses):
                    sender.connect(dense.s_in)
                    dense.a_out.connect(target.a_in)
                    self.kept.append(dense)
            sink = self.sinks[layer["name"]] = Sink(shape=target.s_out.shape, buffer=1)
            through(target.s_out, "NxToPyAdapter", arguments.board).connect(sink.a_in)

    def run(self, rows):
        """Inject the rows (T, M), one in each timestep; probe every layer after each."""
        found = {name: {"current": [], "membrane": [], "spikes": []} for name in self.layers}
        for row in rows:
            if self.source.is_compiled:
                self.source.data.set(row.astype(np.int32)[:, None])
            else:
                self.source.data.init[:, 0] = row
            self.source.run(RunSteps(num_steps=1), self.config)
            for name, neurons in self.layers.items():
                found[name]["current"].append(neurons.u.get().astype(np.int64))
                found[name]["membrane"].append(neurons.v.get().astype(np.int64))
                found[name]["spikes"].append(self.sinks[name].data.get()[:, 0].astype(np.int64))
        return {name: {q: np.array(r) for q, r in each.items()} for name, each in found.items()}

    def reset(self):
        """Zero currents, membranes, and the sums that connections deliver in the next timestep.

        Those are all variables of lava.proc.lif and lava.proc.dense that change; Var.set writes
        them between two runs. On a board, sums under way have no such name: a fresh run there.
        """
        if self.arguments.board:
            self.stop()
            self.__init__(self.program, self.arguments)
            return
        changing = [var for each in self.layers.values() for var in (each.u, each.v)]
        for var in [*changing, *(dense.a_buff for dense in self.kept)]:
            var.set(np.zeros(var.shape, np.int32))

    def stop(self):
        """End lava's processes, which else keep the script from ending."""
        self.source.stop()


def through(port, name, board):
    """The port itself, or on a board that of lava-loihi's adapter behind it, by its name."""
    if not board:
        return port
    from lava.proc.embedded_io import spike  # of lava-loihi

    adapter = getattr(spike, name)(shape=port.shape)
    port.connect(adapter.inp)
    return adapter.out


def neurons(layer):
    """Neurons with the registers of a layer; bias exponents are lava's one for all."""
    exponent = max(layer["bias_exp"])
    mantissa = np.left_shift(layer["bias_mant"], layer["bias_exp"])
    if (mantissa >> exponent << exponent != mantissa).any():
        sys.exit(f"layer {layer['name']}: lava has one bias exponent for all neurons of a process")
    if len(set(layer["vth"])) > 1:
        sys.exit(f"layer {layer['name']}: lava has one threshold for all neurons of a process")
    return LIF(
        shape=(layer["neurons"],),
        du=np.array(layer["decay_u"]),
        dv=np.array(layer["decay_v"]),
        vth=layer["vth"][0],
        bias_mant=mantissa >> exponent,
        bias_exp=exponent,
    )


def connections(synapses):
    """A process for the weights from 0 and one for those to 0: Loihi's two lists of weights."""
    weights = np.array(synapses["weights"]).T
    options = {"weight_exp": synapses["exponent"] - synapses["shift"], "num_weight_bits": 8}
    for mode, part in (
        (SignMode.EXCITATORY, np.maximum(weights, 0)),
        (SignMode.INHIBITORY, np.minimum(weights, 0)),
    ):
        if not part.any():
            continue
        if synapses["delay"] == 1:
            yield Dense(weights=part, sign_mode=mode, **options)
        else:
            late = synapses["delay"] - 1
            yield DelayDense(weights=part, delays=late, sign_mode=mode, **options)


if __name__ == "__main__":
    code = main(LavaChip, "lava", [("--board", "run on the hardware instead of lava's simulator")])
    sys.exit(code)
