"""Texts of Verilog: parameters, and the contents of memories."""

from collections.abc import Sequence


def hex_text(words: Sequence[int], bits: int) -> str:
    """The contents of a memory for $readmemh, a word a line."""
    digits = -(-bits // 4)
    return "".join(f"{word:0{digits}x}\n" for word in words)
