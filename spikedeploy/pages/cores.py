"""The cores of a chip as a drawing: what each layer takes of their neurons and of their memory."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from html import escape

from spikedeploy.runtime.chips.limits import Limits
from spikedeploy.runtime.design_rules.mapping import CoreMapping, Placement, of_placement

COLOURS = ("chip", "ann", "green", "snn", "yellow", "sky", "pink")  # variables of page.css
_COLUMNS, _MOST = 16, 256  # cores in a line, and all that are drawn of a larger chip
_CELL, _GAP = 40, 6


@dataclass(frozen=True)
class CoreFill:
    """What a core holds.

    number   of the core
    layer    whose neurons it has
    neurons  of that layer in this core
    shares   of its neurons and of its synaptic memory that are taken; None where there is no limit
    """

    number: int
    layer: str
    neurons: int
    shares: tuple[float | None, float | None]


def core_fills(mapping: CoreMapping, limits: Limits) -> list[CoreFill]:
    """The cores that are taken; the memory of each is that of the fullest of its layer."""
    return [fill for placement in mapping.placements for fill in _of(placement, limits)]


def _of(placement: Placement, limits: Limits) -> Iterator[CoreFill]:
    if placement.first is None:
        return
    fullest = of_placement(placement, limits)
    for place in range(placement.cores):
        held = min(placement.block, placement.neurons - place * placement.block)
        share = None if fullest.neurons is None else fullest.neurons * held / placement.block
        if limits.layer_cores:  # of which each holds a whole layer
            held, share = placement.neurons, fullest.neurons
        shares = share, fullest.memory
        yield CoreFill(placement.first + place, placement.name, held, shares)


def cores_svg(mapping: CoreMapping, limits: Limits, chip: str) -> str:
    """The cores line by line, each with a bar of its neurons and one of its memory; or nothing."""
    fills = core_fills(mapping, limits)[:_MOST]
    if not fills:
        return ""
    there = len(limits.layer_cores) or (limits.cores or 0) * (mapping.chips or 1)
    last = max(fill.number for fill in fills) + 1
    count = max(last, min(there, _MOST))
    colours = layer_colours(mapping)
    lines, wide = -(-count // _COLUMNS), min(count, _COLUMNS)
    size = f"{wide * (_CELL + _GAP) + _GAP} {lines * (_CELL + _GAP) + _GAP}"
    alt = f"{len(fills)} cores of {chip}, filled by neurons (left) and synaptic memory (right)"
    taken = {fill.number: fill for fill in fills}
    cells = (_core(number, taken.get(number), colours) for number in range(count))
    return (
        f'<svg class="cores" role="img" aria-label="{escape(alt)}" viewBox="0 0 {size}" '
        f'style="width:{wide * (_CELL + _GAP)}px">{"".join(cells)}</svg>'
    )


def layer_colours(mapping: CoreMapping) -> dict[str, str]:
    """Layer -> its colour on the page."""
    names = [placement.name for placement in mapping.placements]
    return {name: f"var(--{COLOURS[k % len(COLOURS)]})" for k, name in enumerate(names)}


def legend(mapping: CoreMapping) -> str:
    """The layers with their colours."""
    items = (
        f'<li style="--dot: {colour}">{escape(name)}</li>'
        for name, colour in layer_colours(mapping).items()
    )
    return f'<ul class="legend">{"".join(items)}</ul>'


def _core(number: int, fill: CoreFill | None, colours: dict[str, str]) -> str:
    x = _GAP + number % _COLUMNS * (_CELL + _GAP)
    y = _GAP + number // _COLUMNS * (_CELL + _GAP)
    bars = "" if fill is None else "".join(_bars(fill, x, y, colours[fill.layer]))
    over = fill is not None and any(share is not None and share > 1 for share in fill.shares)
    return (
        f"<g{' class=over' if over else ''}><title>{escape(_said(number, fill))}</title>"
        f'<rect x="{x}" y="{y}" width="{_CELL}" height="{_CELL}" rx="5"/>{bars}</g>'
    )


def _bars(fill: CoreFill, x: int, y: int, colour: str) -> Iterator[str]:
    width = (_CELL - 6) // 2
    for place, share in enumerate(fill.shares):
        if share is not None:
            height = max(1.5, (_CELL - 4) * min(share, 1.0))
            opacity = "" if place == 0 else ' opacity="0.55"'
            yield (
                f'<rect class="fill" x="{x + 2 + place * (width + 2)}" '
                f'y="{y + _CELL - 2 - height:.1f}" width="{width}" height="{height:.1f}" rx="2" '
                f'fill="{colour}"{opacity}/>'
            )


def _said(number: int, fill: CoreFill | None) -> str:
    """What a core holds, in words."""
    if fill is None:
        return f"core {number}: free"
    names = ("neurons", "synaptic memory")
    shares: Sequence[str] = [
        f"{share:.1%} of its {name}"
        for share, name in zip(fill.shares, names, strict=True)
        if share is not None
    ]
    return ", ".join([f"core {number}: {fill.layer}, {fill.neurons:,} neurons", *shares])
