"""Run this kit's program on SpiNNaker2 by py-spinnaker2, or on its Brian2 back-end.

    python run_spinnaker2.py --sim      spinnaker2.brian2_sim, without a board
    python run_spinnaker2.py            the board; its address is in the variable S2_IP

NOT RUN by us, on neither: py-spinnaker2 is not on PyPI (https://gitlab.com/spinnaker2/py-spinnaker2).
The calls are those that public scripts for it make. A run goes from zero states to its last
timestep, and the host sees spikes when it has ended: --loop is for policies that reset their states
in each control step, which is then a run.
"""

import os
import sys

from host import main, needs, np, resets

with needs("py-spinnaker2 from https://gitlab.com/spinnaker2/py-spinnaker2"):
    from spinnaker2 import snn

RESETS = {"subtract": "reset_by_subtraction", "zero": "reset_to_v_reset"}


class Spinnaker2Chip:
    """The program as populations and projections of py-spinnaker2."""

    def __init__(self, program, arguments):
        if arguments.loop and not resets(program):
            sys.exit("a run of py-spinnaker2 begins from zero states, which this policy keeps")
        self.program, self.arguments, self.sim = program, arguments, arguments.sim
        self.network = snn.Network("kit")
        width = program["input"]["width"]
        self.input = snn.Population(size=width, neuron_model="spike_list", params={}, name="input")
        self.layers = {layer["name"]: population(layer, program) for layer in program["layers"]}
        self.network.add(self.input, *self.layers.values())
        for layer in program["layers"]:
            for synapses in layer["synapses"]:
                sender = self.layers.get(synapses["source"], self.input)
                weights = np.array(synapses["weights"]) << synapses["exponent"]
                # [pre, post, weight, delay]; these neuron models have no delays of their own
                listed = [[int(m), int(n), int(weights[m, n]), 0] for m, n in np.argwhere(weights)]
                target = self.layers[layer["name"]]
                self.network.add(snn.Projection(pre=sender, post=target, connections=listed))

    def run(self, rows):
        """Inject the rows (T, M); spikes (T, N) of every layer."""
        self.input.params = {m: np.flatnonzero(rows[:, m]).tolist() for m in range(rows.shape[1])}
        if self.sim:
            from spinnaker2 import brian2_sim

            brian2_sim.Brian2Backend().run(self.network, len(rows))
        else:
            from spinnaker2 import hardware

            hardware.SpiNNaker2Chip(eth_ip=os.environ["S2_IP"]).run(self.network, len(rows))
        found = {}
        for name, layer in self.layers.items():
            spikes = np.zeros((len(rows), layer.size), int)
            for neuron, times in layer.get_spikes().items():
                spikes[np.array(times, int), neuron] = 1
            found[name] = {"spikes": spikes}
        return found

    def reset(self):
        """Make the network anew: each run begins from zero states."""
        self.__init__(self.program, self.arguments)

    def stop(self):
        """Do nothing: there is no hardware to release."""


def population(layer, program):
    """Neurons with the parameters of a layer; with a current where it outlasts its timestep."""
    params = {
        "threshold": layer["threshold"],
        "alpha_decay": layer["alpha_decay"],
        "i_offset": layer["bias"],
        "v_init": [0.0] * layer["neurons"],
        "v_reset": [0.0] * layer["neurons"],
        "reset": RESETS[program["reset"]],
    }
    model = "lif_no_delay"
    if any(layer["exc_decay"]):
        model = "lif_curr_exp_no_delay"
        params |= {"exc_decay": layer["exc_decay"], "inh_decay": layer["exc_decay"], "t_refrac": 0}
    return snn.Population(
        size=layer["neurons"],
        neuron_model=model,
        params=params,
        name=layer["name"],
        record=["spikes"],
    )


if __name__ == "__main__":
    options = [("--sim", "run the Brian2 back-end instead of a board")]
    sys.exit(main(Spinnaker2Chip, "py-spinnaker2", options))
