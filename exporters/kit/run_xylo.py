"""Run this kit's program on a Xylo dev kit by Rockpool and samna, or by xylosim.

    python run_xylo.py --sim            SynSense's simulator 0.1.3; no Rockpool, no samna
    python run_xylo.py                  the dev kit, by "rockpool[xylo]"; never run by us
    python run_xylo.py [--sim] --loop [ENV]   the closed loop; without ENV on recorded observations

All layers but the last are Xylo's one population of hidden neurons. Input events act in their
timestep, hidden spikes in the next.
"""

import sys
from importlib import import_module

from host import main, needs, np, resets


def specification(program):
    """Rockpool's names for the program, and the first hidden neuron of each layer."""
    for layer in program["layers"]:
        for synapses in layer["synapses"]:
            if synapses["delay"] != (synapses["source"] != program["input"]["name"]):
                sys.exit(f"a delay of {synapses['delay']} timesteps is not Xylo's")
    xylo = program["xylo"]
    found = {name: np.array(value) for name, value in xylo["specification"].items()}
    found.setdefault("dash_syn_2", 0 * found["dash_syn"])
    return found, xylo["first"]


def split(program, first, hidden, output):
    """Tables of the hidden population (quantity -> (T, N)) layer by layer, and the output's."""
    found = {}
    for layer in program["layers"][:-1]:
        own = slice(first[layer["name"]], first[layer["name"]] + layer["neurons"])
        found[layer["name"]] = {name: np.array(rows)[:, own] for name, rows in hidden.items()}
    found[program["output"]] = {name: np.array(rows) for name, rows in output.items()}
    return found


class XylosimChip:
    """The program in xylosim."""

    def __init__(self, program, arguments):
        with needs("xylosim==0.1.3"):
            from xylosim.v2 import XyloLayer, XyloSynapse

        self.program = program
        spec, self.first = specification(program)

        def listed(matrix):
            """Return the non-zero synapses of each presynaptic neuron."""
            matrix = matrix.reshape(*matrix.shape[:2], -1)
            return [[XyloSynapse(int(n), int(k), int(row[n, k])) for n, k in np.argwhere(row)]
                    for row in matrix]  # fmt: skip

        # xylosim holds bare pointers to its synapses: they have to outlive it
        self.synapses = {name: listed(spec[f"weights_{name}"]) for name in ("in", "rec", "out")}
        self.layer = XyloLayer(
            synapses_in=self.synapses["in"],
            synapses_rec=self.synapses["rec"],
            synapses_out=self.synapses["out"],
            aliases=[[] for _ in spec["threshold"]],
            threshold=spec["threshold"].tolist(),
            threshold_out=spec["threshold_out"].tolist(),
            has_bias="bias_hidden" in spec,
            bias=spec.get("bias_hidden", 0 * spec["threshold"]).tolist(),
            bias_out=spec.get("bias_out", 0 * spec["threshold_out"]).tolist(),
            weight_shift_inp=int(spec["weight_shift_in"]),
            weight_shift_rec=int(spec["weight_shift_rec"]),
            weight_shift_out=int(spec["weight_shift_out"]),
            dash_mem=spec["dash_mem"].tolist(),
            dash_mem_out=spec["dash_mem_out"].tolist(),
            dash_syns=np.stack([spec["dash_syn"], spec["dash_syn_2"]], axis=1).tolist(),
            dash_syns_out=spec["dash_syn_out"][:, None].tolist(),
            name="kit",
        )
        self.ran = 0

    def run(self, rows):
        """Events (T, M) in, states and spikes after each timestep out."""
        self.layer.evolve(rows.tolist())
        x, new = self.layer, slice(-len(rows), None)
        hidden = {
            "current": np.array(x.rec_i_syn).T[new],
            "membrane": np.array(x.rec_v_mem).T[new],
            "spikes": np.array(x.rec_recurrent_spikes)[new],
        }
        if len(self.program["layers"][0]["dash_syn"]) > 1:
            hidden["current 2"] = np.array(x.rec_i_syn2).T[new]
        output = {
            "current": np.array(x.rec_i_syn_out).T[new],
            "membrane": np.array(x.rec_v_mem_out).T[new],
            "spikes": np.array(x.rec_out_spikes)[new],
        }
        return split(self.program, self.first, hidden, output)

    def reset(self):
        """Zero all states and spikes, as Rockpool's XyloSim.reset_state does."""
        self.layer.reset_all()

    def stop(self):
        """Do nothing: there is no hardware to release."""


MODULES = {"xylo-a2": "syns61201", "xylo-a3": "syns65302", "xylo-imu": "syns63300"}


class XyloBoard:
    """The program on a dev kit, by Rockpool's XyloSamna."""

    def __init__(self, program, arguments):
        if resets(program) and program["chip"] != "xylo-a2":
            # in Rockpool 3.1.0, reset_state of syns65302 warns that it does not work yet, and that
            # of syns63300 is a module's without states: neither changes the dev kit
            sys.exit(f"Rockpool 3.1.0 cannot zero the states of {program['chip']}: use --sim")
        # importing these imports samna, which on its first import installs itself
        with needs('"rockpool[xylo]==3.1.0", or run it with --sim'):
            from rockpool.devices.xylo.helper import find_xylo_hdks
        module = import_module(f"rockpool.devices.xylo.{MODULES[program['chip']]}")
        kits, _, versions = find_xylo_hdks()
        if not kits:
            sys.exit("no Xylo dev kit was found; with --sim, xylosim runs the program")
        self.program = program
        spec, self.first = specification(program)
        config, valid, message = module.config_from_specification(**spec)
        if not valid:
            sys.exit(f"samna refuses the configuration: {message}")
        print(f"running on {versions[0]}")
        self.board = module.XyloSamna(kits[0], config, dt=program["dt"])

    def run(self, rows):
        """Events (T, M) in, what the dev kit records out; its states go on."""
        spikes, _, seen = self.board(rows, record=True)
        size = sum(layer["neurons"] for layer in self.program["layers"][:-1])
        hidden = {"current": seen["Isyn"], "membrane": seen["Vmem"], "spikes": seen["Spikes"]}
        hidden = {name: np.array(rows)[:, :size] for name, rows in hidden.items()}
        output = {"current": seen["Isyn_out"], "membrane": seen["Vmem_out"], "spikes": spikes}
        return split(self.program, self.first, hidden, output)

    def reset(self):
        """Zero the states by XyloSamna.reset_state, which sets samna's clear_network_state."""
        self.board.reset_state()

    def stop(self):
        """Do nothing: samna closes the dev kit when the script ends."""


if __name__ == "__main__":

    def chip(program, arguments):
        """The simulator or the dev kit."""
        return (XylosimChip if arguments.sim else XyloBoard)(program, arguments)

    sys.exit(main(chip, "xylo", [("--sim", "run xylosim instead of a dev kit")]))
