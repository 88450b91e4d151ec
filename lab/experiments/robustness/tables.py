"""Tables and sentences of the robustness page."""

from collections.abc import Sequence
from typing import Any

from lab.experiments.robustness.design import DISTURBANCE, FAULT, UNDISTURBED
from spikedeploy.reports.table import ABSENT, markdown_text

Record = dict[str, Any]
MIDDLE = 2  # the level of the sentences
ENOUGH = 0.9  # of the undisturbed return


def policies(rows: Sequence[Record]) -> list[str]:
    """Labels of the policies, in the order of their rows."""
    return list(dict.fromkeys(row["policy"] for row in rows))


def undisturbed_table(rows: Sequence[Record]) -> str:
    """Returns and successes where nothing is wrong."""
    lines = [["policy", "return", "success", "episodes"]]
    lines += [
        [r["policy"], f"{r['return_mean']:,.0f}", _success(r), f"{r['episodes']}"]
        for r in rows
        if r["part"] == UNDISTURBED
    ]
    return markdown_text(lines)


def _success(row: Record) -> str:
    return ABSENT if row["success_rate"] is None else f"{row['success_rate']:.0%}"


def kept_table(rows: Sequence[Record], part: str) -> str:
    """What each policy keeps at each level; empty without rows of the part."""
    found = [row for row in rows if row["part"] == part]
    names = policies(found)
    by_condition: dict[tuple[str, int], dict[str, Record]] = {}
    for row in found:
        by_condition.setdefault((row["name"], row["level"]), {})[row["policy"]] = row
    lines = [["", "number", *(["hit"] if part == FAULT else []), *names]]
    for (name, level), each in by_condition.items():
        first = next(iter(each.values()))
        hit = [_hit(each)] if part == FAULT else []
        cells = [kept(each.get(policy)) for policy in names]
        lines.append([f"{name}:{level}", f"{first['number']:g} [{first['unit']}]", *hit, *cells])
    return markdown_text(lines) if found else ""


def kept(row: Record | None) -> str:
    """`97% [95, 99]`; the return itself where it is a loss; a dash where there is no row."""
    if row is None:
        return ABSENT
    if row.get("kept") is None:
        return f"{row['return_mean']:,.0f}" if row.get("return_mean", 0) < 0 else ABSENT
    return f"{row['kept']:.0%} [{100 * row['kept_low']:.0f}, {100 * row['kept_high']:.0f}]"


def _hit(each: dict[str, Record]) -> str:
    """How much a fault hit, policy by policy."""
    hits = [f"{row['hit'] / max(row['of'], 1):.2g}" for row in each.values() if row.get("of")]
    what = next((row["what"] for row in each.values() if row.get("what")), "")
    return f"{', '.join(hits)} of {what}" if hits else ABSENT


def sentences(rows: Sequence[Record]) -> list[str]:
    """What spiking policies keep at the middle level, beside the float ANN."""
    middle = [row for row in rows if row["level"] == MIDDLE and row.get("kept") is not None]
    ann = next((row["policy"] for row in rows if row["kind"] == "ann"), None)
    found = []
    for policy in dict.fromkeys(row["policy"] for row in rows if row["kind"] == "snn"):
        own = [row for row in middle if row["policy"] == policy]
        for part, word in ((DISTURBANCE, "disturbances"), (FAULT, "faults")):
            of = [row for row in own if row["part"] == part]
            if of:
                found.append(_kept_of(policy, of, word))
        beside = _beside(own, [row for row in middle if row["policy"] == ann])
        if ann and beside is not None:
            found.append(_worse(policy, ann, beside, _controls(middle)))
    return [f"* {each}" for each in found]


def _kept_of(policy: str, rows: Sequence[Record], word: str) -> str:
    enough = [row["name"] for row in rows if row["kept"] >= ENOUGH]
    less = [f"{row['name']} {kept(row)}" for row in rows if row["kept"] < ENOUGH]
    rest = f"; less under {', '.join(less)}" if less else ""
    return (
        f"**{policy}** keeps {ENOUGH:.0%} or more of its own undisturbed return under "
        f"{len(enough)} of {len(rows)} {word} at level {MIDDLE}{rest}."
    )


def _beside(own: Sequence[Record], ann: Sequence[Record]) -> list[tuple[Record, Record]] | None:
    """Rows in which the float ANN keeps enough and the policy does not; None without an ANN."""
    if not ann:
        return None
    of_ann = {row["name"]: row for row in ann}
    return [
        (row, of_ann[row["name"]])
        for row in own
        if row["name"] in of_ann and row["kept"] < ENOUGH <= of_ann[row["name"]]["kept"]
    ]


def _controls(rows: Sequence[Record]) -> dict[str, list[str]]:
    """Condition -> what each float control keeps."""
    found: dict[str, list[str]] = {}
    for row in rows:
        if row["kind"] == "control":
            found.setdefault(row["name"], []).append(f"{row['policy']} {row['kept']:.0%}")
    return found


def _worse(
    policy: str, ann: str, pairs: Sequence[tuple[Record, Record]], controls: dict[str, list[str]]
) -> str:
    if not pairs:
        return f"Wherever {ann} keeps {ENOUGH:.0%} at level {MIDDLE}, {policy} does."
    said = ", ".join(
        f"{own['name']} ({kept(own)} against {kept(of)}"
        + "".join(f"; {control}" for control in controls.get(own["name"], ()))
        + ")"
        for own, of in pairs
    )
    return f"Where {ann} keeps {ENOUGH:.0%} at level {MIDDLE} and {policy} does not: {said}."
