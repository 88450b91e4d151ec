"""A compiled program as files of Verilog: the core, its parameters and its memories."""

from importlib.resources import files

from spikedeploy.exporters.verilog.image import CoreImage
from spikedeploy.exporters.verilog.text import hex_text

CORE, PARAMETERS, SIMULATION = "policy_core.v", "policy_params.vh", "sim_main.cpp"


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
    lines = [f"// {origin}"]
    for name, value in image.localparams.items():
        if isinstance(value, tuple):
            number, bits = value
            digits = f"{number & ((1 << bits) - 1):x}"
            lines.append(f"localparam [{bits - 1}:0] {name} = {bits}'h{digits};")
        else:
            lines.append(f"localparam {name} = {value};")
    return "\n".join(lines) + "\n"
