"""The page of the kart experiment: results/kart.md, its tables as CSV, and its picture."""

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from lab.experiments import pages
from lab.experiments.kart import (
    CORRIDOR,
    COUNT,
    DEFAULT,
    FIRST,
    GREEDY,
    HELD,
    LEARNING,
    NETWORKS,
    NTH,
    PEERS,
    POLICIES,
    PRESETS,
    TRACKS,
    UNSEEN,
    WORLDS,
    KartDesign,
    KartTraining,
    Steps,
    driving,
    each_finish,
    heldout,
    learning,
    write_csv,
)
from lab.experiments.pages import grouped, versions_at_start, versions_text
from lab.experiments.ratios import ratio_of
from lab.experiments.runner import command_line
from lab.experiments.training import Record
from spikedeploy.comparison.statistics import Estimate, nested_ratio
from spikedeploy.comparison.statistics import share as wilson
from spikedeploy.policies.registry import FLOAT
from spikedeploy.reports.plots import BLUE, VERMILION, save
from spikedeploy.reports.table import ABSENT, format_si
from spikedeploy.runtime.files import read_json
from spikedeploy.trainers.ppo import HOLDS
from spikedeploy.trainers.versions import own

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def write(design: KartDesign, results: Path) -> list[Path]:
    """Write page, tables and picture of the complete parts; return the files."""
    learned, driven, tracks = learning(design), driving(design), heldout(design)
    folder = results / "kart"
    files = [
        write_csv(learned, folder / "learning.csv"),
        write_csv(driven, folder / "driving.csv"),
        write_csv(tracks, folder / "tracks.csv"),
        write_csv(each_finish(design), folder / "finishes.csv"),
        save(drawn := finishes_figure(design), folder / "finishes.png"),
    ]
    said = [*learning_verdicts(learned), *_chip_verdicts(driven), *heldout_verdicts(tracks)]
    page, shown = pages.write_page(
        results / "kart.md",
        {"kart/finishes.png": drawn},
        command=command_line(),
        design=design,
        missing=_missing(design),
        verdicts="\n".join(said),
        learned={preset: _of_preset(learned, preset) for preset in PRESETS},
        driven={preset: _of_preset(driven, preset) for preset in PRESETS},
        prices=_prices,
        tracks=list(_heldout_rows(tracks)),
        facts="\n".join(_facts(design)),
        **{"COUNT": COUNT, "GREEDY": GREEDY, "UNSEEN": UNSEEN, "TRACKS": TRACKS, "WORLDS": WORLDS},
        **{"POLICIES": POLICIES, "PEERS": PEERS, "FIRST": FIRST, "NTH": NTH, "HELD": HELD},
        **{"of": of, "steps": steps, "share": share, "drivers": _drivers, "on_chip": on_chip},
        **{"median": _median, "joules": _joules, "cell": _cell, "FLOAT": FLOAT},
    )
    return [page, *files, shown]


def _of_preset(rows: Iterable[Record], preset: str) -> list[Record]:
    return [row for row in rows if row["preset"] == preset]


def _prices(rows: Iterable[Record]) -> list[str]:
    return list(dict.fromkeys(name for row in rows for name in row if name.startswith("energy_")))


def _missing(design: KartDesign) -> str:
    """How many parts are complete, and of what trainings are not; empty where all are."""
    parts = design.parts()
    done = sum(part.is_done for part in parts)
    if done == len(parts):
        return ""
    lack = [t for t in design.trainings() if t.evaluation is None]
    left = Counter(f"{t.preset} {t.policy}" for t in lack)
    text = f"**{done} of {len(parts)} parts are complete.**"
    missing = ", ".join(f"{name} {count}" for name, count in left.items())
    return f"{text} Trainings that are missing: {missing}." if left else text


def _facts(design: KartDesign) -> Iterator[str]:
    """Facts needed to reproduce the experiment."""
    trainings = design.trainings()
    yield f"- spikedeploy {own()}; run folders in `{design.runs}`"
    yield (
        f"- training seeds asked for: 0 to {design.seeds - 1}; of controls 0 to "
        f"{design.controls - 1}"
    )
    yield from (_end(trainings, preset) for preset in PRESETS)
    files = [t.run / "versions.json" for t in trainings if t.run and t.is_trained]
    yield from versions_at_start(versions_text(read_json(file)) for file in files if file.is_file())
    yield from (f"- `--set {setting}`" for setting in design.settings)
    yield from pages.other_settings(trainings, pages.CHANGED)
    yield (
        "- every number: [learning.csv](kart/learning.csv), [driving.csv](kart/driving.csv), "
        "[tracks.csv](kart/tracks.csv), [finishes.csv](kart/finishes.csv)"
    )


def _end(trainings: Sequence[KartTraining], preset: str) -> str:
    """When the trainings of a preset end."""
    own = [training for training in trainings if training.preset == preset]
    configs = {training.world: training.config for training in own}
    budgets = ", ".join(f"{config.steps:,} ({world})" for world, config in configs.items())
    config = own[0].config
    limits = []
    if config.stop_at_finishes:
        limits.append(f"{config.stop_at_finishes} finishes")
    if config.stop_at_greedy:
        limits.append(f"{HOLDS} validations in a row of greedy {config.stop_at_greedy:.0%}")
    early = f" {' and '.join(limits)}, or" if limits else ""
    return f"- {preset}: a training ends with{early} its budget of environment steps: {budgets}"


def of(rows: Iterable[Record], world: str, policy: str, **more: object) -> list[Record]:
    """The rows of a policy in a world, and with the other fields that are given."""
    wanted = {"world": world, "policy": policy, **more}
    return [row for row in rows if all(row[key] == value for key, value in wanted.items())]


def on_chip(rows: Iterable[Record], world: str) -> list[Record]:
    """The spiking policies of a world where they ran on a chip."""
    return [row for row in of(rows, world, "snn") if row["chip"] != FLOAT]


def steps(rows: Sequence[Record], field: str) -> str:
    """Median [least, most] in thousands: `251k [240k, > 500k]`.

    A training that ended at 500k without counts with these; what it could raise has a `>`.
    """
    if not rows:
        return ABSENT
    values = steps_taken(rows, field)
    ended = [row["env_steps"] for row in rows if math.isinf(row[field])]

    def text(value: float) -> str:
        least = "> " if any(each <= value for each in ended) else ""
        return f"{least}{value / 1000:,.0f}k"

    return f"{text(float(np.median(values)))} [{text(min(values))}, {text(max(values))}]"


def steps_taken(rows: Iterable[Record], field: str) -> list[float]:
    """Steps of trainings (n,) to what a field says; those that never came so far, all they took."""
    return [min(row[field], row["env_steps"]) for row in rows]


@dataclass(frozen=True)
class AnnShare:
    """The median steps of the ANN over those of a policy, with an interval over training seeds.

    estimate  of the share
    bound     "≥" or "≤" where trainings of the ANN, or of the policy, did not come so far: they
              count with all the steps that they took; else empty
    """

    estimate: Estimate
    bound: str = ""

    def __str__(self) -> str:
        """`97.4% [95%, 102%]`, `≥ 151.4% [126%, 193%]`."""
        low, high = self.estimate.ci95
        return f"{self.bound} {self.estimate.mean:.1%} [{low:.0%}, {high:.0%}]".lstrip()

    def mark(self, asked: float) -> str:
        """✓ where the whole interval reaches what is asked, ✗ where none of it can, else ≈."""
        found = self.estimate.mark(asked)
        return "≈" if (self.bound, found) in (("≥", "✗"), ("≤", "✓")) else found


def share(
    rows: Sequence[Record], world: str, policy: str = "snn", field: str = NTH
) -> AnnShare | None:
    """Median steps of the ANN / median steps of a policy.

    None where some trainings of both did not come so far: then it has no bound.
    """
    ann, own = (of(rows, world, each) for each in ("ann", policy))
    late = [any(math.isinf(row[field]) for row in each) for each in (ann, own)]
    if not ann or not own or all(late):
        return None
    bound = "≥" if late[0] else "≤" if late[1] else ""
    top, bottom = steps_taken(ann, field), steps_taken(own, field)
    return AnnShare(ratio_of(np.median, top, bottom), bound)


def _drivers(rows: Sequence[Record], world: str) -> Iterator[tuple[str, list[Record]]]:
    """Label and rows: networks, then controls, then built-in policies."""
    order = {policy: place for place, policy in enumerate(POLICIES)}
    here = [row for row in rows if row["world"] == world]
    here.sort(key=lambda row: order.get(row["policy"], len(order)))
    for (policy, chip), found in grouped(here, "policy", "chip"):
        yield f"{policy} · {chip}" if chip else policy, found


def _values(rows: Sequence[Record], field: str) -> list[float]:
    return [row[field] for row in rows if row.get(field) is not None]


def _median(rows: Sequence[Record], field: str, form: str, with_range: bool = False) -> str:
    """The median of the rows that have the field, and [least, most] of several."""
    values = _values(rows, field)
    if not values:
        return ABSENT
    middle = format(float(np.median(values)), form)
    ends = f" [{format(min(values), form)}, {format(max(values), form)}]"
    return middle + (ends if with_range and len(values) > 1 else "")


def _joules(rows: Sequence[Record], price: str) -> str:
    """The median energy by a table; with `≥` where it is a lower bound."""
    values, table = _values(rows, price), price.removeprefix("energy_").removesuffix("_j")
    least = "≥ " if any(table in row["energies_at_least"].split() for row in rows) else ""
    return f"{least}{format_si(float(np.median(values)))}J" if values else ABSENT


# held-out tracks

_TRAINED_ON = {DEFAULT: "big_S", CORRIDOR: "corridor-8"}


def _heldout_rows(rows: Sequence[Record]) -> Iterator[tuple[str, str, str, list[Record]]]:
    """World, track that was trained on, driver, and the rows of its trainings."""
    for world in WORLDS:
        for preset in (CORRIDOR, DEFAULT):
            for policy in POLICIES:
                if found := of(rows, world, policy, preset=preset):
                    chip = found[0]["chip"]
                    label = f"{policy} · {chip}" if chip else policy
                    yield world, _TRAINED_ON[preset], label, found
        scripts = (row["policy"] for row in rows if row["seed"] is None and row["world"] == world)
        for script in dict.fromkeys(scripts):
            yield world, ABSENT, script, of(rows, world, script)


def _cell(rows: Sequence[Record], track: str) -> str:
    finished = [row["finished"] for row in rows if row["track"] == track]
    return pages.percent(finish_share(finished)) if finished else ABSENT


def finish_share(finished: Sequence[Sequence[int]]) -> Estimate:
    """The mean of (S, n) starts of S trainings, with an interval over trainings and starts.

    One training, or trainings that agree in every start, have Wilson's interval over the starts:
    resamples of equal values would have none.
    """
    each = np.asarray(finished, np.float64)
    if (each == each[0]).all():
        return wilson(each[0])
    return nested_ratio(each, np.ones(each.shape[1]))


def _on_unseen(rows: Sequence[Record], world: str, policy: str) -> NDArray[np.float64]:
    """The mean share (S,) over the unseen tracks, of each training in corridors."""
    found = [r for r in of(rows, world, policy, preset=CORRIDOR) if r["unseen"]]
    return np.array(
        [
            np.mean([np.mean(r["finished"]) for r in found if r["seed"] == seed])
            for seed in dict.fromkeys(row["seed"] for row in found)
        ]
    )


# sentences

_NEAR = 0.95  # of the ANN: what an SNN is asked to reach
_SOME = 0.05  # of the starts on other tracks, below which an ANN is nothing to be compared with
_POINTS = 2  # of the finish rate that the chip may differ from the float twin


def learning_verdicts(learned: Sequence[Record]) -> list[str]:
    """Steps beside kart-simulator's, and the SNN beside the ANN, for each preset and world."""
    lines = []
    for preset in PRESETS:
        rows = [row for row in learned if row["preset"] == preset]
        for world in WORLDS:
            if preset in LEARNING:  # as kart-simulator's
                for policy in NETWORKS:
                    lines += _finishes(rows, f"{preset}, {world}", world, policy)
            for field, what in ((NTH, f"{COUNT} finishes"), (HELD, f"greedy {GREEDY:.0%}")):
                found = share(rows, world, "snn", field)
                lines += _near(found, f"{preset}, {world}", f"in steps to {what}")
                lines += [] if found else _came_to(rows, preset, world, field, what)
    return lines


def _finishes(rows: Sequence[Record], where: str, world: str, policy: str) -> list[str]:
    found = of(rows, world, policy)
    if not found:
        return []
    limit, median = 1000 * PEERS[world][policy][1], float(np.median([row[NTH] for row in found]))
    known = math.isfinite(median)
    text = f"{median / 1000:,.0f}k steps" if known else "more steps than it was trained"
    # of a training that ended without, it is only known that it takes longer
    mark = "✓" if median <= limit else "✗" if np.median(steps_taken(found, NTH)) > limit else "≈"
    return [
        f"- {mark} {where}, {policy}: {COUNT} finishes after {text} (median), "
        f"kart-simulator {limit / 1000:,.0f}k"
    ]


def _came_to(rows: Sequence[Record], preset: str, world: str, field: str, what: str) -> list[str]:
    """How many trainings of both came so far, where that leaves no share; empty without any."""
    found = {
        each: [math.isfinite(row[field]) for row in of(rows, world, each)] for each in NETWORKS
    }
    if not all(found.values()):
        return []
    said = ", ".join(f"{sum(came)} of {len(came)} {each}" for each, came in found.items())
    return [f"- ≈ {preset}, {world}: trainings that came to {what}: {said}; no share of steps"]


def _near(found: AnnShare | None, where: str, what: str) -> list[str]:
    """Return whether the SNN comes near the ANN; its interval says whether that can be told."""
    if found is None:
        return []
    text = f"{where}: the SNN reaches {found} of the ANN {what} (asked for: at least {_NEAR:.0%})"
    mark = found.mark(_NEAR)
    return [f"- {mark} {text}" + ("; the interval is on both sides" if mark == "≈" else "")]


def _chip_verdicts(driven: Sequence[Record]) -> list[str]:
    """Chip beside float twin, for each preset and world."""
    lines = []
    for preset in PRESETS:
        rows = [row for row in driven if row["preset"] == preset]
        for world in WORLDS:
            chips = on_chip(rows, world)
            apart = [abs(100 * row["success_difference_mean"]) for row in chips]
            if any(apart) or any(row["success_rate"] for row in chips):  # else neither drives
                text = (
                    f"chip and float twin differ by up to {max(apart):.0f} points of the finish "
                    f"rate (asked for: at most {_POINTS})"
                )
                lines.append(_verdict(max(apart) <= _POINTS, f"{preset}, {world}: {text}"))
    return lines


def heldout_verdicts(rows: Sequence[Record]) -> list[str]:
    """On tracks that nothing was trained on: networks beside the script, the SNN beside the ANN."""
    lines = []
    for world in WORLDS:
        shares = {policy: _on_unseen(rows, world, policy) for policy in NETWORKS}
        script = [
            np.mean(row["finished"])
            for row in rows
            if (row["world"], row["policy"], row["unseen"]) == (world, "gap", True)
        ]
        for policy, found in shares.items():
            if found.size and script:
                text = (
                    f"held-out tracks, {world}: {policy}, trained in corridors, finishes "
                    f"{found.mean():.0%} of the starts (mean over tracks and trainings), the gap "
                    f"follower {np.mean(script):.0%}"
                )
                lines.append(_verdict(bool(found.mean() > np.mean(script)), text))
        if all(each.size for each in shares.values()) and shares["ann"].mean() >= _SOME:
            near = AnnShare(ratio_of(np.mean, shares["snn"], shares["ann"]))
            lines += _near(near, f"held-out tracks, {world}", "in finished starts")
    return lines


def _verdict(reached: bool, text: str) -> str:
    return f"- {'✓' if reached else '✗'} {text}"


# the picture

_COLOURS = dict(zip(NETWORKS, (BLUE, VERMILION), strict=True))
_NAMES = {"ann": "float ANN", "snn": "SNN"}
_GRID = 400  # points of a line


def finishes_figure(design: KartDesign) -> "Figure":
    """All complete trainings of the two networks."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 7.0), layout="constrained")
    panels = figure.subplots(len(LEARNING), len(WORLDS), sharey=True, squeeze=False)
    for preset, row in zip(LEARNING, panels, strict=True):
        for world, axes in zip(WORLDS, row, strict=True):
            _panel(axes, design, preset, world)
        row[0].set_ylabel(f"finished episodes of training, up to {COUNT}")
    pairs = [
        pair for axes in panels.flat for pair in zip(*axes.get_legend_handles_labels(), strict=True)
    ]
    named = {name: line for line, name in pairs}
    figure.legend(
        named.values(), named.keys(), loc="outside upper center", ncols=len(named), frameon=False
    )
    return figure


def _panel(axes: "Axes", design: KartDesign, preset: str, world: str) -> None:
    from matplotlib.ticker import EngFormatter

    for policy in NETWORKS:
        trained = [
            each
            for each in design.trainings()
            if (each.preset, each.world, each.policy) == (preset, world, policy) and each.is_trained
        ]
        if trained:
            lengths = [float(each.env_steps) for each in trained]
            _curve(axes, [each.finishes for each in trained], lengths, policy)
        axes.plot(
            1000 * PEERS[world][policy][1], COUNT, "x", color=_COLOURS[policy], clip_on=False,
            zorder=5, label=f"kart-simulator's {policy.upper()}",
        )  # fmt: skip
    axes.set_title(f"{world}, {preset}", loc="left", fontsize=11, pad=10)
    axes.set_xlabel("environment steps")
    axes.xaxis.set_major_formatter(EngFormatter(sep=""))
    axes.set_ylim(0, COUNT)
    axes.set_xlim(left=0)
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(color="#E6E8EB")


def _curve(axes: "Axes", runs: Sequence[Steps], lengths: Sequence[float], policy: str) -> None:
    grid, counts = count_finishes(runs, lengths)
    axes.fill_between(
        grid,
        counts.min(axis=0),
        counts.max(axis=0),
        color=_COLOURS[policy],
        alpha=0.18,
        linewidth=0,
    )
    label = f"{_NAMES[policy]}: median and range"
    axes.plot(grid, np.median(counts, axis=0), color=_COLOURS[policy], linewidth=1.8, label=label)


def count_finishes(
    runs: Sequence[Steps], lengths: Sequence[float]
) -> tuple[Steps, NDArray[np.int64]]:
    """A grid of steps (g,), and the finishes of each run there, at most COUNT (n, g).

    The grid ends where every run has COUNT finishes, or where the shortest run without them ends.
    """
    ends = [r[COUNT - 1] if len(r) >= COUNT else math.inf for r in runs]
    short = [length for length, end in zip(lengths, ends, strict=True) if math.isinf(end)]
    last = min(short) if short else max(ends)
    grid = np.linspace(0, last, _GRID)
    return grid, np.stack(
        [np.searchsorted(run, grid, side="right").clip(max=COUNT) for run in runs]
    )
