"""Resources that a core takes on a board, predicted before synthesis: cells and memories.

Memories follow the rules by which Yosys 0.23 maps them: block RAMs are equal in the builds that
tests compare, and another version may choose otherwise. Cells are a sum of terms of the widths of
registers, whose factors are a fit to builds; in the builds that tests compare they are within a
tenth.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from spikedeploy.exporters.verilog.boards import Board, Device
from spikedeploy.exporters.verilog.image import CoreImage, unsigned_bits
from spikedeploy.runtime.errors import RuleError
from spikedeploy.runtime.files import read_toml

# of each family: factors of the cells, shapes of a block RAM, and what Yosys counts for one
_FAMILIES: Mapping[str, Any] = read_toml(Path(__file__).with_name("boards.toml"))["family"]
# costs by which Yosys chooses: of a bit of a multiplexer behind several block RAMs, and of a bit
# that becomes logic
_MULTIPLEXER_COST = 0.5
_CONSTANT_COST, _VARIABLE_COST = 1 / 16, 1
# RAM that an ECP5 makes of its cells
_SMALL_WORDS, _SMALL_BITS, _SMALL_COST = 16, 4, 4
# memories that can be in it: one port is enough for them
_MOVABLE = ("state_memory", "buffer")
_LARGE_WORDS, _LARGE_BITS = 16384, 16  # of the single-port RAM of the UltraPlus
# share of a board's cells above which a design may not fit: predictions can be a tenth off
_CLOSE = 0.9
# of the longest reply of the link: its length is a byte
_WORDS_MOST = 255


@dataclass(frozen=True)
class Buffer:
    """The buffer of link.v for a core.

    words: of a timestep.
    """

    words: int

    def check(self) -> None:
        """Refuse more words than a reply has; RuleError."""
        if self.words > _WORDS_MOST:
            raise RuleError(
                f"rule link: {self.words} words leave the core in a timestep; a reply has at most "
                f"{_WORDS_MOST}. Read fewer membranes, or spikes in place of them."
            )

    @property
    def address_bits(self) -> int:
        """Bits of an address: half of the buffer is for words, of two numbers each."""
        return max(8, (2 * self.words - 1).bit_length() + 1)

    @property
    def tokens_most(self) -> int:
        """Tokens of a request."""
        return min(_WORDS_MOST, 1 << (self.address_bits - 1))

    @property
    def words_most(self) -> int:
        """Words of a reply."""
        return min(_WORDS_MOST, 1 << (self.address_bits - 2))


@dataclass(frozen=True)
class Place:
    """A way to make a memory.

    rams: what it costs by Yosys's count, without multiplexers.
    kind: "blocks" of RAM, "small" RAMs in cells, or "logic".
    count: of these, or bits of logic.
    multiplexers: bits that are chosen between RAMs, or between words side by side.
    """

    rams: float
    kind: str
    count: int
    multiplexers: int

    @property
    def cost(self) -> float:
        """Cost by which Yosys chooses: the lowest wins."""
        return self.rams + _MULTIPLEXER_COST * self.multiplexers


@dataclass(frozen=True)
class CoreMemory:
    """A memory of the design.

    name: as the Verilog calls it.
    words: W; bits: of each, without those that are always the same.
    constant: whether nothing is written to it.
    """

    name: str
    words: int
    bits: int
    constant: bool

    def place(self, device: Device) -> "Place":
        """Memory to which Yosys maps it."""
        family, found = _FAMILIES[device.family], []
        for words, bits in family["shapes"]:
            # words that are this far apart stand side by side, and share RAMs
            deep = -(-self.words // words)
            count = -(-deep * self.bits // bits)
            found.append(
                Place(count * family["block_cost"], "blocks", count, (deep - 1) * self.bits)
            )
        bit = _CONSTANT_COST if self.constant else _VARIABLE_COST
        found.append(Place(self.words * self.bits * bit, "logic", self.words * self.bits, 0))
        if device.family == "ecp5" and not self.constant:
            deep = -(-self.words // _SMALL_WORDS)
            count = deep * -(-self.bits // _SMALL_BITS)
            found.append(Place(count * _SMALL_COST, "small", count, (deep - 1) * self.bits))
        return min(found, key=lambda place: place.cost)

    @property
    def large(self) -> int:
        """Large RAMs that it takes."""
        return -(-self.words // _LARGE_WORDS) * -(-self.bits // _LARGE_BITS)


def memories_of(image: CoreImage) -> tuple[CoreMemory, ...]:
    """The memories of the core and its link."""
    contents = {
        "axon_memory": image.axon_words,
        "synapse_memory": image.rows.words,
        "neuron_memory": image.neuron_words,
    }
    constant = (CoreMemory(name, len(w), _varying_bits(w), True) for name, w in contents.items())
    return (
        *constant,
        CoreMemory("sum_memory", image.slots << image.neuron_bits, image.sum_bits, False),
        CoreMemory(
            "state_memory", 2 << image.neuron_bits, image.state_bits + image.rest_bits, False
        ),
        CoreMemory("buffer", 1 << Buffer(image.words).address_bits, 16, False),
    )


def _varying_bits(words: Sequence[int]) -> int:
    """Count the bits that differ between words; constant bits take no memory."""
    varying = 0
    for word in words:
        varying |= word ^ words[0]
    return varying.bit_count()


@dataclass(frozen=True)
class Use:
    """Resources of an FPGA that a design takes.

    board: with the FPGA.
    cells, block_rams, large_rams, multipliers: of it.
    states_in_large_ram, buffer_in_large_ram: whether the states, and the link's buffer, are there,
        as block RAM is short.
    """

    board: Board
    cells: int
    block_rams: int
    large_rams: int
    multipliers: int
    states_in_large_ram: bool = False
    buffer_in_large_ram: bool = False

    def rows(self) -> Iterator[tuple[str, int, int]]:
        """Rows of resource, count in the design, and count in the FPGA."""
        device = self.board.device
        yield "cells", self.cells, device.cells
        yield f"block RAMs of {device.block_bits} bits", self.block_rams, device.block_rams
        if device.large_rams:
            yield "large RAMs", self.large_rams, device.large_rams
        yield "multipliers", self.multipliers, device.multipliers

    @property
    def full(self) -> tuple[str, ...]:
        """Resources of which the FPGA has too few."""
        return tuple(name for name, taken, there in self.rows() if taken > there)

    @property
    def fits(self) -> bool:
        """True if the FPGA has enough of all."""
        return not self.full

    def check(self) -> None:
        """Refuse a design that does not fit; RuleError."""
        for name, taken, there in self.rows():
            if taken > there:
                raise RuleError(
                    f"rule {'cells' if name == 'cells' else 'memory'}: the policy takes about "
                    f"{taken:,} {name}; the {self.board.device.title} of {self.board.title} has "
                    f"{there:,}. Choose a larger board, or a policy with fewer synapses; a policy "
                    "that fits no board needs memory outside the FPGA, which the core does not use."
                )

    def lines(self) -> tuple[str, ...]:
        """Return the resources as lines for a terminal."""
        return tuple(
            f"{name:<26} {taken:>7,} of {there:,}"
            + (f" ({taken / there:.0%})" if there else "")
            + self._remark(name, taken, there)
            for name, taken, there in self.rows()
            if taken or there
        )

    @staticmethod
    def _remark(name: str, taken: int, there: int) -> str:
        """Return the remark of a line on a number that is, or may be, too large."""
        if taken > there:
            return ", too few"
        return ", may not fit" if name == "cells" and taken > _CLOSE * there else ""

    def record(self) -> dict[str, Any]:
        """Return the resources as plain data."""
        return {
            "cells": self.cells,
            "block_rams": self.block_rams,
            "large_rams": self.large_rams,
            "multipliers": self.multipliers,
            "fits": self.fits,
        }


def predict(image: CoreImage, board: Board) -> Use:
    """Predict the resources that a core with its link takes on a board."""
    device = board.device
    placed = {each: each.place(device) for each in memories_of(image)}
    blocks = {m.name: place.count for m, place in placed.items() if place.kind == "blocks"}
    in_cells = {
        kind: sum(place.count for place in placed.values() if place.kind == kind)
        for kind in ("logic", "small")
    }
    in_cells["multiplexers"] = sum(place.multiplexers for place in placed.values())
    large: dict[str, int] = {}
    # block RAM comes first: every board has it, and tools make Verilog of its bitstream again
    for each in placed:
        short = sum(blocks.values()) > device.block_rams
        fits = each.large + sum(large.values()) <= device.large_rams
        if each.name in _MOVABLE and each.name in blocks and short and fits:
            large[each.name], blocks[each.name] = each.large, 0
    return Use(
        board,
        cells=round(_cells(image, device, in_cells)),
        block_rams=sum(blocks.values()),
        large_rams=sum(large.values()),
        multipliers=0,
        states_in_large_ram="state_memory" in large,
        buffer_in_large_ram="buffer" in large,
    )


def _cells(image: CoreImage, device: Device, in_cells: Mapping[str, int]) -> float:
    """Cells of a core with its link; in_cells: what its memories take of them."""
    edges = sum(each.overflow not in ("none", "wrap") for each in image.registers.values())
    rows = image.rows
    terms = {
        "all": 1,
        "states": image.state_bits + image.adder_bits + image.value_bits,
        "addresses": image.sum_bits
        + rows.weight_bits
        + rows.entry_bits
        + rows.address_bits
        + 3 * (image.neuron_bits + unsigned_bits(image.slots - 1)),
        "spikes": any(not output.silent for output in image.outputs),
        **in_cells,
        "parameters": image.neuron_word_bits,
        "edges": edges * image.value_bits,
    }
    factors: Mapping[str, float] = _FAMILIES[device.family]["cells"]
    return sum(factor * terms[name] for name, factor in factors.items())
