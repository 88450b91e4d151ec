"""A compiled program as files of Verilog: the core, its parameters and its memories."""

from importlib.resources import files

from spikedeploy.exporters.verilog.image import CoreImage
from spikedeploy.exporters.verilog.text import comment_text, hex_text

CORE, PARAMETERS, SIMULATION = "policy_core.v", "policy_params.vh", "sim_main.cpp"

# what stands behind a parameter
_NOTES = {
    "AXONS": "channels of the input",
    "AXON_COUNT": "the same, to compare a token with",
    "NEURONS": "of all layers, numbered in the order in which they are updated",
    "LAYERS": "in that order",
    "NEURON_WORD_BITS": "parameters of a neuron; the lowest bits are its layer's number",
    "SLOT_MASK": "timesteps that a neuron has a sum for, less 1",
    "SUMS": "words of their memory: slots, each of a power of two of neurons",
    "SYNAPSES": "in all rows, fillers of weight 0 included",
    "SYNAPSE_BITS": "{last of its row, gap to the target before, weight}",
    "FIRST_OF_INPUT": "{slots from now, neuron} from which the first gap of a row counts",
    "FIRST_OF_NEURONS": "the same of a neuron's row",
    "ROW_BITS": "{weights are subtracted, first synapse}",
    "SUM_BITS": "largest sum of weights of a neuron, whatever spikes [units of its layer]",
    "DRIVE_BITS": "the same [state units]",
    "STATE_BITS": "largest current and membrane that their registers hold [state units]",
    "VALUE_BITS": "largest number that any register holds [state units]",
    "ADDER_BITS": "largest sum before a register holds it [state units]",
    "DECAY_BITS": "a decay is a fraction of 2 to this",
    "COUNT_BITS": "counts the bits of a decay",
    "LAST_BIT": "of a decay",
    "DECAY_FIELD": "one bit more than DECAY_BITS where a state can be kept whole",
    "RESTS": "timesteps that a neuron rests after a spike",
    "REST_BITS": "their register; 0 for none",
    "STATE_WORD_BITS": "a state, and the timesteps that are left to rest",
    "RESET_SUBTRACTS": "a spike subtracts the threshold; else the membrane is 0",
    "HEARS_SPIKES": "the host listens to a layer that spikes",
    "LAST_HEARD": "the neuron with which the last word leaves",
    "ACCUMULATOR_KIND": "registers: as policy_register has it",
    "SHIFT_OF": "of each layer, 8 bits: from its units to state units",
    "CURRENT_DECAY_AT": "lowest bit in the parameters of a neuron; -1: _OF has one for each layer",
}


def template(name: str) -> str:
    """The text of a file in templates/."""
    return files(__package__).joinpath(f"templates/{name}").read_text(encoding="ascii")


def core_files(image: CoreImage, origin: str) -> dict[str, str]:
    """Text of the files of a core, by name.

    origin: where the program comes from, for a comment.
    """
    return {
        CORE: template(CORE),
        PARAMETERS: parameters_text(image, origin),
        "axons.hex": hex_text(image.axon_words, image.rows.entry_bits),
        "synapses.hex": hex_text(image.rows.words, image.rows.bits),
        "neurons.hex": hex_text(image.neuron_words, image.neuron_word_bits),
        SIMULATION: template(SIMULATION),
    }


def parameters_text(image: CoreImage, origin: str) -> str:
    """The parameters of the core in Verilog."""
    lines = [
        f"// {comment_text(origin)}",
        "// Parameters of policy_core.v; all widths follow from the numbers of the policy.",
    ]
    for name, value in image.localparams.items():
        note = f"  // {_NOTES[name]}" if name in _NOTES else ""
        if isinstance(value, tuple):
            number, bits = value
            digits = f"{number & ((1 << bits) - 1):x}"
            lines.append(f"localparam [{bits - 1}:0] {name} = {bits}'h{digits};{note}")
        else:
            lines.append(f"localparam {name} = {value};{note}")
    return "\n".join(lines) + "\n"
