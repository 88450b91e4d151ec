"""The robustness experiment: return under disturbances of the world and faults of the chip.

Each row is a file of its own, <runs>/<condition>/<policy>.json, which says what it was made with: a
stopped experiment goes on after the last row, and a row whose policy, level or sizes have changed
is made again. All policies of a part share the copies of the environment.
"""

import json
import re
import shlex
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache, cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from lab.experiments import pages
from lab.experiments.networks import BatchOnChip
from lab.experiments.pages import grouped
from lab.experiments.ratios import grouped_ratio
from lab.experiments.runner import Design, Part
from lab.experiments.training import NUMBER, Record, StoredRow, read_rows
from spikedeploy import envs, zoo
from spikedeploy.comparison.lineup import Entry
from spikedeploy.envs.disturbances import Kind, kinds_of
from spikedeploy.envs.disturbances import row as row_of
from spikedeploy.make_env import make_env, parse_options
from spikedeploy.policies.onnx import OnnxController
from spikedeploy.policies.registry import BUILT_IN, check_fit, find
from spikedeploy.reports.plots import BLUE, VERMILION, save
from spikedeploy.reports.table import ABSENT, write_rows
from spikedeploy.runtime.artifact.artifact import load
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.chips.damage import Damage, sum_damage
from spikedeploy.runtime.emulator.controllers import SpikingController
from spikedeploy.runtime.errors import ConfigError, EnvError
from spikedeploy.runtime.faults import FAULTS, faults
from spikedeploy.runtime.files import as_text, read_json, write_text
from spikedeploy.runtime.requests import LEVELS
from spikedeploy.seeds import EVALUATION
from spikedeploy.shipping.exported_run import runnable
from spikedeploy.trainers.config import EnvConfig
from spikedeploy.trainers.sparse.pool import BatchController, Episodes, Stateless

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

ENVS = ("hexapod", "hexapod-command", "kart-grid", "kart-gazebo", "kart-steer")
_OF_NUMBERS = ("noise", "bias")
UNDISTURBED, DISTURBANCE, FAULT = "undisturbed", "disturbance", "fault"
_VERSION = 1  # of what a row holds; a higher one makes all rows again
_FORM = {  # of a row
    **dict.fromkeys(("env", "policy", "kind", "part", "name"), str),
    "episodes": int,
    "groups": [int],
    "returns": [NUMBER],
}
_QUICK_PARTS = 8  # of a job
# float controls beside the float ANN, as far as they are shipped, from the strongest on
_SMALL = ("mlp-32", "pruned", "small", "linear")


def _shipped(env: str, chip: str) -> list[Entry]:
    """The shipped float ANNs, small float networks, and spiking policies on the chip."""
    every = [find(str(path)) for path in zoo.policies(env)]
    small = [c for name in _SMALL for c in every if c.name == name and c.kind != "snn"]
    found = [c for c in every if c.kind == "ann" and c not in small]
    spiking = [c for c in every if c.kind == "snn" and c.format == ".nir"]
    return [Entry(c) for c in [*found, *small]] + [Entry(c, chip) for c in spiking]


def _files_of(names: Sequence[str], env: str, options: Mapping[str, Any]) -> list[str]:
    """Files of policies by name; run folders are exported. ConfigError where one does not fit."""
    if own := [name for name in names if name in BUILT_IN]:
        raise ConfigError(f"--policies {own[0]} is built in and has no file. Leave it out.")
    candidates = [find(runnable(name)) for name in names]
    world = make_env(env, options)
    for candidate in candidates:
        check_fit(candidate, world)
    world.close()
    short = [candidate.name for candidate in candidates]
    if twice := [name for name in short if short.count(name) > 1]:
        raise ConfigError(f"--policies: two are called {twice[0]}. Give one of them another name.")
    return [candidate.path for candidate in candidates]


@dataclass(frozen=True)
class Condition:
    """A disturbance, a fault, or neither.

    part    UNDISTURBED, DISTURBANCE or FAULT
    name    of the disturbance or fault; empty where nothing is wrong
    level   1 to 3; 0 where nothing is wrong
    number  of that level
    unit    of the number
    """

    part: str = UNDISTURBED
    name: str = ""
    level: int = 0
    number: float = 0.0
    unit: str = ""

    @property
    def text(self) -> str:
        """`noise:2`, as the command line takes it; `undisturbed`."""
        return f"{self.name}:{self.level}" if self.name else UNDISTURBED


@dataclass(frozen=True)
class RobustnessDesign(Design):
    """The parts of the experiment in one environment.

    env        short name, id of gymnasium, or module:Class
    specimens  faulty chips of each fault and level, among which the episodes are divided
    files      of policies; those that are shipped by default
    options    of the environment
    """

    episodes: int = 30
    env: str = ""
    specimens: int = 5
    files: Sequence[str] = ()
    options: Mapping[str, Any] = field(default_factory=dict)

    NAME = "robustness"
    OPTIONS: ClassVar = {name: name for name in ("env", "runs", "episodes", "chip", "quick")} | {
        "policies": "files", "set": "options"
    }  # fmt: skip
    QUICK: ClassVar = {"episodes": 2, "specimens": 2, "limit": 25}
    ENVS: ClassVar = ENVS

    def __post_init__(self) -> None:
        try:
            foreign = envs.spec(self.env).foreign
        except EnvError as error:
            raise ConfigError(
                f"the robustness experiment has no environment {self.env!r}: {error}"
            ) from error
        if foreign and not self.files:
            raise ConfigError(
                f"no policies for {self.env} are shipped: name yours, as in --policies last"
            )
        super().__post_init__()

    @classmethod
    def of(cls, options: Mapping[str, Any]) -> Any:  # noqa: ANN401
        """The design of the options; files of policies are found, and fit the environment."""
        if "env" not in options:
            return super().of(options)
        env = str(options["env"])
        folder = "robustness-quick" if options.get("quick") else "robustness"
        found = {"runs": str(Path("runs") / folder / file_name(env)), **options}
        if "set" in options:
            found["set"] = parse_options(options["set"])
        names = [n for text in options.get("policies", ()) for n in text.split(",") if n]
        if names:
            found["policies"] = _files_of(names, env, found.get("set", {}))
        return super().of(found)

    @cached_property
    def policies(self) -> list[Entry]:
        """Those that were named, or all that are shipped; spiking ones on the chip."""
        if not self.files:
            return _shipped(self.env, self.chip)
        found = [find(path) for path in self.files]
        tested = [Entry(each, self.chip if each.kind == "snn" else None) for each in found]
        return sorted(tested, key=lambda each: each.chip is not None)

    def conditions(self, name: str) -> list[Condition]:
        """The conditions of a part: every level of a disturbance or fault, or the undisturbed."""
        if name == UNDISTURBED:
            return [Condition()]
        if name in FAULTS:
            kind, part = FAULTS[name], FAULT
            numbers: Sequence[float] = kind.levels
            unit = kind.unit
        else:
            disturbance = self._kinds[name]
            numbers, part = disturbance.levels[row_of(self._world)], DISTURBANCE
            unit = disturbance.unit
        pairs = zip(LEVELS, numbers, strict=True)
        return [Condition(part, name, level, number, unit) for level, number in pairs]

    @property
    def names(self) -> list[str]:
        """Names of the parts: the undisturbed, then of disturbances and faults."""
        return [UNDISTURBED, *self._kinds, *FAULTS]

    @cached_property
    def _kinds(self) -> dict[str, Kind]:
        """Disturbances that the world has; one of several levels has neither noise nor bias."""
        found = kinds_of(self._world)
        if envs.spec(self.env).foreign:
            world = make_env(self.env, self.options)
            if getattr(world.unwrapped, "one_hot", False):
                found = {name: kind for name, kind in found.items() if name not in _OF_NUMBERS}
            world.close()
        return found

    @property
    def _world(self) -> str:
        return envs.spec(self.env).world

    def tested(self, name: str) -> list[Entry]:
        """The policies of a part: faults are of chips."""
        found = self.policies
        return [each for each in found if each.chip] if name in FAULTS else found

    def parts(self) -> list[Part]:
        """One for each disturbance or fault, and the undisturbed."""
        return [Part(name, partial(self.rows, name)) for name in self.names]

    def bundles(self, names: list[str]) -> list[list[str]]:
        """A job a part; of a quick look, whose parts are shorter than a start, one for many."""
        size = _QUICK_PARTS if self.quick else 1
        return [names[at : at + size] for at in range(0, len(names), size)]

    # rows

    def rows(self, part: str) -> list[StoredRow]:
        """The rows of a part, of all its levels and policies."""
        episodes = cache(self._episodes)
        return [
            self._row(condition, tested, episodes)
            for condition in self.conditions(part)
            for tested in self.tested(part)
        ]

    def _row(
        self, condition: Condition, tested: Entry, episodes: Callable[..., Episodes]
    ) -> StoredRow:
        made = {
            "env": self.env,
            "policy": zoo.sha256(Path(tested.candidate.path)),
            "chip": tested.chip,
            "condition": condition.text,
            "number": condition.number,
            "episodes": self.episodes,
            "specimens": self.specimens if condition.part == FAULT else None,
            "first_seed": EVALUATION,
            "limit": self.limit,
            "version": _VERSION,
            **({"options": dict(self.options)} if self.options else {}),
        }
        folder = Path(self.runs) / condition.text.replace(":", "-")
        name = f"{tested.candidate.name}{f'@{tested.chip}' if tested.chip else ''}.json"
        evaluate = partial(self._evaluate, condition, tested, episodes)
        return StoredRow(folder / name.replace(":", "-"), made, evaluate, form=_FORM)

    def _episodes(self, *disturb: str) -> Episodes:
        """Copies of the environment, which all rows share that it disturbs alike."""
        options = {**self.options, **({"disturb": list(disturb)} if disturb else {})}
        config = EnvConfig(name=self.env, options=options, count=self.episodes)
        return Episodes(config, self.episodes, self.limit)

    def _evaluate(
        self, condition: Condition, tested: Entry, shared: Callable[..., Episodes]
    ) -> Record:
        """Returns of the policy, episode by episode, and what faults of the chip hit."""
        episodes = shared(*([condition.text] if condition.part == DISTURBANCE else []))
        returns, successes = np.zeros(self.episodes), np.zeros(self.episodes, np.bool_)
        is_known = True  # whether the environment says what a success is
        is_broken = condition.part == FAULT
        damages: list[Sequence[Damage]] = []
        # what an interval resamples: the specimen of each episode, else each
        groups = np.arange(self.episodes) % (self.specimens if is_broken else self.episodes)
        for specimen in range(groups.max() + 1 if is_broken else 1):
            places = np.flatnonzero((groups == specimen) | (not is_broken))
            seeds = (EVALUATION + places).tolist()
            controller: BatchController
            if tested.chip is None:
                controller = Stateless(OnnxController(tested.candidate.path).replay)
            else:
                broken = faults([condition.text] if is_broken else [], specimen)
                spiking = SpikingController(
                    load(tested.candidate.path), chip(tested.chip), "none", faults=broken
                )
                controller = BatchOnChip(spiking, seeds)
            _, returns[places], infos = episodes.play(seeds, controller)
            damages += [spiking.damage] if tested.chip and spiking.damage else []
            successes[places] = [bool(info.get("success", False)) for info in infos]
            is_known = is_known and all("success" in info for info in infos)
        hit = sum_damage(damages)  # parts of all specimens together, or what happened in all
        return {
            "env": self.env,
            "policy": tested.label,
            "kind": tested.candidate.kind,
            "chip": tested.chip,
            "part": condition.part,
            "name": condition.name,
            "level": condition.level,
            "number": condition.number,
            "unit": condition.unit,
            "episodes": self.episodes,
            "return_mean": float(returns.mean()),
            "success_rate": float(successes.mean()) if is_known else None,
            **({"hit": hit[0].hit, "of": hit[0].of, "what": hit[0].what} if hit else {}),
            "groups": groups.tolist(),
            "returns": returns.tolist(),
            "successes": successes.astype(int).tolist() if is_known else None,
        }

    def write(self, results: Path) -> list[Path]:
        """Write page, table and picture of the complete rows; return the files.

        Where there are no rows, the table that is there is kept.
        """
        found, folder = list(self.all_rows()), results / "robustness"
        table = folder / f"{file_name(self.env)}.csv"
        if found or not table.is_file():
            write_table(found, table)
            write_text(table.with_suffix(".json"), as_text(self._facts()))
        others = sorted(path.stem for path in folder.glob("*.csv") if path.stem not in ENVS)
        tables = {env: folder / f"{env}.csv" for env in (*ENVS, *others)}
        rows = {env: read_table(path) for env, path in tables.items() if path.is_file()}
        drawn = {f"robustness/{env}.png": levels_figure(of) for env, of in rows.items()}
        picture = save(drawn[f"robustness/{table.stem}.png"], table.with_suffix(".png"))
        page, shown = pages.write_page(
            results / "robustness.md",
            drawn,
            tasks={
                env: _task(env, of, read_json(tables[env].with_suffix(".json")))
                for env, of in rows.items()
            },
            kept=kept_text,
            hit=_hit_text,
            **{"MIDDLE": MIDDLE, "ENOUGH": ENOUGH},
        )
        return [page, table, picture, shown]

    def _facts(self) -> Record:
        """Facts on the making of a table."""
        parts = self.parts()
        left = sum(not part.is_done for part in parts)
        limit = f", of at most {self.limit} control steps" if self.limit else ""
        command = pages.command(self, self.env, sizes=["episodes"])
        command += f" --policies {shlex.quote(','.join(self.files))}" if self.files else ""
        values = {k: v if isinstance(v, str) else json.dumps(v) for k, v in self.options.items()}
        settings = (f"{name}={value}" for name, value in values.items())
        return {
            "command": pages.with_settings(command, settings),
            "missing": f"**{left} of {len(parts)} parts are missing.**" if left else "",
            "facts": [
                f"- {pages.releases('numpy', 'mujoco', 'pymunk')}",
                f"- {self.episodes} episodes from seed 10,000 on{limit}; under faults divided "
                f"among {self.specimens} faulty chips",
            ],
        }


def file_name(env: str) -> str:
    """The name of an environment in names of files: `my_module:MyEnv` is `my_module-MyEnv`."""
    return re.sub(r"[^\w.-]+", "-", env)


MIDDLE = 2  # the level of the sentences
ENOUGH = 0.9  # of the undisturbed return
_COLUMNS = (
    "env", "policy", "kind", "chip", "part", "name", "level", "number", "unit", "episodes",
    "return_mean", "success_rate", "kept", "kept_low", "kept_high", "hit", "of", "what",
    "groups", "returns", "successes",
)  # fmt: skip
_TEXT = ("env", "policy", "kind", "chip", "part", "name", "unit", "what")


def _task(env: str, rows: list[Record], made: Record) -> Record:
    """Facts that the template shows of an environment."""
    calm = [row for row in rows if row["part"] == UNDISTURBED]
    tables = {}
    for title, part in (("Disturbances of the world", DISTURBANCE), ("Faults of the chip", FAULT)):
        of = [row for row in rows if row["part"] == part]
        conditions = {
            f"{name}:{level}": {row["policy"]: row for row in each}
            for (name, level), each in grouped(of, "name", "level")
        }
        tables[title] = (policies(of), conditions, part == FAULT)
    return made | {
        "env": rows[0]["env"] if rows else env,
        "facts": "\n".join(made["facts"]),
        "sentences": "\n".join(sentences(rows)),
        "loses": any((row["return_mean"] or 0) < 0 for row in calm),
        "undisturbed": calm,
        "tables": tables,
    }


def write_table(found: Iterable[Record], path: Path) -> Path:
    """Write rows with what is kept; missing fields stay empty."""
    return write_rows(with_kept(list(found)), _COLUMNS, path)


def read_table(path: Path) -> list[Record]:
    """The rows of a CSV; missing fields are None."""
    return read_rows(path, _TEXT)


def with_kept(rows: Sequence[Record]) -> list[Record]:
    """The rows with the share of the undisturbed return that is kept, and its interval."""
    calm = {row["policy"]: row for row in rows if row["part"] == UNDISTURBED}
    found = []
    for row in rows:
        of, kept = calm.get(row["policy"]), {}
        if of and row["part"] != UNDISTURBED and np.sum(of["returns"]) > 0:
            share = grouped_ratio(row["returns"], of["returns"], row["groups"])
            low, high = share.ci95
            kept = {"kept": share.mean, "kept_low": low, "kept_high": high}
        found.append(row | kept)
    return found


def policies(rows: Sequence[Record]) -> list[str]:
    """Labels of the policies, in the order of their rows."""
    return list(dict.fromkeys(row["policy"] for row in rows))


def kept_text(row: Record | None) -> str:
    """`97% [95, 99]`; the return itself where it is a loss; a dash where there is no row."""
    if row is None:
        return ABSENT
    if row.get("kept") is None:
        return f"{row['return_mean']:,.0f}" if row.get("return_mean", 0) < 0 else ABSENT
    return f"{row['kept']:.0%} [{100 * row['kept_low']:.0f}, {100 * row['kept_high']:.0f}]"


def _hit_text(rows: Iterable[Record]) -> str:
    """How much a fault hit, policy by policy."""
    known = [row for row in rows if row.get("of")]
    hits = ", ".join(f"{row['hit'] / max(row['of'], 1):.2g}" for row in known)
    return f"{hits} of {known[0]['what']}" if known else ABSENT


def sentences(rows: Sequence[Record]) -> list[str]:
    """Sentences on what spiking policies keep at the middle level, beside the float ANN."""
    middle = [row for row in rows if row["level"] == MIDDLE and row.get("kept") is not None]
    ann = next((row["policy"] for row in rows if row["kind"] == "ann"), None)
    of_ann = {row["name"]: row for row in middle if row["policy"] == ann}
    found = []
    for policy in dict.fromkeys(row["policy"] for row in rows if row["kind"] == "snn"):
        own = [row for row in middle if row["policy"] == policy]
        for part, word in ((DISTURBANCE, "disturbances"), (FAULT, "faults")):
            if of := [row for row in own if row["part"] == part]:
                found.append(_kept_of(policy, of, word))
        if ann and of_ann:
            worse = [
                _beside(row, beside, middle)
                for row in own
                if (beside := of_ann.get(row["name"])) and row["kept"] < ENOUGH <= beside["kept"]
            ]
            found.append(
                f"Where {ann} keeps {ENOUGH:.0%} at level {MIDDLE} and {policy} does not: "
                f"{', '.join(worse)}."
                if worse
                else f"Wherever {ann} keeps {ENOUGH:.0%} at level {MIDDLE}, {policy} does."
            )
    return [f"* {each}" for each in found]


def _kept_of(policy: str, rows: Sequence[Record], word: str) -> str:
    enough = [row["name"] for row in rows if row["kept"] >= ENOUGH]
    less = [f"{row['name']} {kept_text(row)}" for row in rows if row["kept"] < ENOUGH]
    rest = f"; less under {', '.join(less)}" if less else ""
    return (
        f"**{policy}** keeps {ENOUGH:.0%} or more of its own undisturbed return under "
        f"{len(enough)} of {len(rows)} {word} at level {MIDDLE}{rest}."
    )


def _beside(own: Record, ann: Record, rows: Sequence[Record]) -> str:
    """What a policy, the float ANN and each float control keep in a condition."""
    controls = "".join(
        f"; {row['policy']} {row['kept']:.0%}"
        for row in rows
        if row["kind"] == "control" and row["name"] == own["name"]
    )
    return f"{own['name']} ({kept_text(own)} against {kept_text(ann)}{controls})"


_PANELS = 5
_FLOATS = (BLUE, "#56B4E9", "#009E73", "#8A939E", "#000000")  # Okabe and Ito 2008
_SPIKING = (VERMILION, "#E69F00", "#CC79A7", "#F0E442")
_MARKERS = "os^Dv"


def levels_figure(rows: Sequence[Record]) -> "Figure":
    """% of the undisturbed return against the level."""
    from matplotlib.figure import Figure

    names = list(dict.fromkeys(row["name"] for row in rows if row["part"] != UNDISTURBED))
    lines = max(1, -(-len(names) // _PANELS))
    figure = Figure(figsize=(12, 2.3 * lines + 0.6), layout="constrained")
    panels = figure.subplots(lines, _PANELS, sharex=True, sharey=True, squeeze=False).flat
    looks = _looks(rows)
    for name, axes in zip(names, panels, strict=False):
        _panel(axes, name, [row for row in rows if row["name"] == name], looks)
    for axes in list(panels):
        axes.axis("off")
    handles = [
        figure.axes[0].plot([], [], color=colour, marker=marker, label=policy)[0]
        for policy, (colour, marker) in looks.items()
    ]
    figure.legend(handles=handles, loc="outside upper center", ncols=5, frameon=False)
    figure.supxlabel("level")
    figure.supylabel("% of the undisturbed return")
    return figure


def _looks(rows: Sequence[Record]) -> dict[str, tuple[str, str]]:
    """Policy -> colour and marker: warm colours spike."""
    kinds = {row["policy"]: row["kind"] for row in rows}
    found, counts = {}, {True: 0, False: 0}
    for place, policy in enumerate(policies(rows)):
        spikes = kinds[policy] == "snn"
        colours = _SPIKING if spikes else _FLOATS
        found[policy] = colours[counts[spikes] % len(colours)], _MARKERS[place % len(_MARKERS)]
        counts[spikes] += 1
    return found


def _panel(
    axes: "Axes", name: str, rows: Sequence[Record], looks: dict[str, tuple[str, str]]
) -> None:
    axes.set_title(name, fontsize=9)
    for policy, (colour, marker) in looks.items():
        of = [row for row in rows if row["policy"] == policy and row.get("kept") is not None]
        if not of:
            continue
        kept = [100.0, *(100 * row["kept"] for row in of)]
        # a bootstrap of few episodes may leave its own mean outside by rounding
        low = [0.0, *(max(0.0, 100 * (row["kept"] - row["kept_low"])) for row in of)]
        high = [0.0, *(max(0.0, 100 * (row["kept_high"] - row["kept"])) for row in of)]
        axes.errorbar(
            [0, *(row["level"] for row in of)], kept, (low, high), color=colour, marker=marker,
            markersize=4, linewidth=1.2, capsize=2,
        )  # fmt: skip
    axes.axhline(100 * ENOUGH, color="#8A939E", linewidth=0.8, linestyle=":")
    axes.set_ylim(0, 115)
    axes.set_xticks(range(4))
    pages.plain(axes)
