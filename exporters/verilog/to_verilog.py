"""A compiled program as files of Verilog: the core, its parameters and its memories."""

from collections.abc import Sequence
from pathlib import Path

from spikedeploy.exporters.rendering import one_line
from spikedeploy.exporters.verilog.image import CoreImage
from spikedeploy.runtime.files import read_toml

CORE, PARAMETERS, SIMULATION = "policy_core.v", "policy_params.vh", "sim_main.cpp"

_NOTES = read_toml(Path(__file__).with_name("parameters.toml"))


def template(name: str) -> str:
    """The text of a file in templates/."""
    return (Path(__file__).parent / "templates" / name).read_text(encoding="ascii")


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
        f"// {one_line(origin)}",
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


def hex_text(words: Sequence[int], bits: int) -> str:
    """The contents of a memory for $readmemh, a word a line."""
    digits = -(-bits // 4)
    return "".join(f"{word:0{digits}x}\n" for word in words)
