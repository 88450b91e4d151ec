"""The score of mutation testing, with its interval and the survivors, as text and as a page."""

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

from benchmarks.mutant_operators import Mutant
from benchmarks.mutant_trials import Fate
from spikedeploy.files import write_text

BEGIN, END = "<!-- mutants: begin -->", "<!-- mutants: end -->"
_FOUND = ("killed", "too long")


def interval(found: int, of: int, z: float = 1.96) -> tuple[float, float]:
    """Wilson's 95 % interval of a share."""
    if not of:
        return 0.0, 1.0
    share = found / of
    middle = (share + z * z / (2 * of)) / (1 + z * z / of)
    half = z / (1 + z * z / of) * math.sqrt(share * (1 - share) / of + (z / (2 * of)) ** 2)
    return middle - half, middle + half


def score(fates: Mapping[Mutant, Fate], equivalent: Mapping[str, str]) -> tuple[int, int]:
    """Faults that a test finds, and faults that one could find."""
    found = sum(fate in _FOUND for fate in fates.values())
    same = sum(m.key in equivalent and fate not in _FOUND for m, fate in fates.items())
    return found, len(fates) - same


def summary(fates: Mapping[Mutant, Fate], everything: int, equivalent: Mapping[str, str]) -> str:
    """The score in a line, and each survivor."""
    found, of = score(fates, equivalent)
    low, high = interval(found, of)
    head = f"{len(fates)} of {everything} faults tried, {len(fates) - of} of them equivalent: "
    head += f"{found} of {of} found, {found / max(of, 1):.1%}"
    if len(fates) < everything:
        head += f" (95 % interval {low:.1%} to {high:.1%})"
    return "\n".join([head, *(f"  {m.line}: {m.key}" for m in survivors(fates, equivalent))])


def survivors(fates: Mapping[Mutant, Fate], equivalent: Mapping[str, str]) -> list[Mutant]:
    """Those that no test finds, in order."""
    left = [m for m, f in fates.items() if f not in _FOUND and m.key not in equivalent]
    return sorted(left, key=lambda m: (m.path, m.line, m.index))


def write_page(
    page: Path,
    fates: Mapping[Mutant, Fate],
    everything: Sequence[Mutant],
    equivalent: Mapping[str, str],
    seed: int,
) -> None:
    """Write the block between the two marks of a Markdown file."""
    text = page.read_text("utf-8")
    head, rest = text.split(BEGIN)
    block = "\n".join(_block(fates, everything, equivalent, seed))
    write_text(page, f"{head}{BEGIN}\n{block}\n{END}{rest.split(END)[1]}")


def _block(
    fates: Mapping[Mutant, Fate],
    everything: Sequence[Mutant],
    equivalent: Mapping[str, str],
    seed: int,
) -> list[str]:
    found, of = score(fates, equivalent)
    low, high = interval(found, of)
    drawn = len(fates) < len(everything)
    how = f"drawn at random with seed {seed}" if drawn else "all of them"
    late = sum(fate == "too long" for fate in fates.values())
    lines = [
        f"**{found / max(of, 1):.1%}**: {found} of {of} faults found "
        f"({late} of them because the tests no longer ended)"
        + (f"; 95 % interval {low:.1%} to {high:.1%}." if drawn else "."),
        "",
        f"Tried: {len(fates)} of {len(everything)} faults, {how}; {len(fates) - of} of them are "
        "equivalent and not counted.",
        "",
        "| file | faults | tried | found | equivalent | survived |",
        "|---|--:|--:|--:|--:|--:|",
        *_rows(fates, everything, equivalent),
        "",
        "Survivors:",
        "",
        *[f"* line {m.line} of {_shown(m)}" for m in survivors(fates, equivalent)],
        "",
        "Equivalent, because",
        "",
        *[
            f"* {_shown(m)}: {equivalent[m.key]}"
            for m, fate in sorted(fates.items(), key=lambda item: item[0].key)
            if m.key in equivalent and fate not in _FOUND
        ],
    ]
    return lines


def _rows(
    fates: Mapping[Mutant, Fate], everything: Sequence[Mutant], equivalent: Mapping[str, str]
) -> list[str]:
    rows = []
    for path, faults in sorted(Counter(m.path for m in everything).items()):
        here = {m: fate for m, fate in fates.items() if m.path == path}
        found, of = score(here, equivalent)
        rows.append(
            f"| `{path}` | {faults} | {len(here)} | {found} | {len(here) - of} | {of - found} |"
        )
    return rows


def _shown(mutant: Mutant) -> str:
    """The key, with the path as code too."""
    path, rest = mutant.key.split(" ", 1)
    return f"`{path}` {' '.join(rest.split())}"
