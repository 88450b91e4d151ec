"""Texts of Verilog: parameters, and the contents of memories."""

from collections.abc import Sequence


def hex_text(words: Sequence[int], bits: int) -> str:
    """The contents of a memory for $readmemh, a word a line."""
    digits = -(-bits // 4)
    return "".join(f"{word:0{digits}x}\n" for word in words)


def comment_text(words: str) -> str:
    """Words that can stand behind // in Verilog: one line of ASCII."""
    known = "".join(c if c.isalnum() or c in " ._:=,+-()/" else "?" for c in words)
    return known.encode("ascii", "replace").decode()
