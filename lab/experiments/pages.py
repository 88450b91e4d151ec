"""Pages of results/ from Markdown templates in templates/, and what their tables have in common."""

import math
import re
import shlex
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from jinja2 import Environment, FileSystemLoader, StrictUndefined

from lab.experiments.runner import Design
from lab.experiments.training import Record, TrainingJob
from spikedeploy.comparison.statistics import Estimate
from spikedeploy.reports.page import write_beside
from spikedeploy.reports.table import ABSENT, markdown_text
from spikedeploy.trainers.versions import installed_version, own

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

ROOT = Path(__file__).resolve().parents[2]
PICO = 1e12
_TEMPLATES = Environment(
    loader=FileSystemLoader(Path(__file__).with_name("templates")),
    undefined=StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
    autoescape=False,
)


def render(template: str, **facts: Any) -> str:  # noqa: ANN401
    """The page of a template; what is empty leaves no gap."""
    text = _TEMPLATES.get_template(f"{template}.md").render(**facts)
    return re.sub(r"\n{3,}", "\n\n", text).strip() + "\n"


def write_page(path: Path, figures: "Mapping[str, Figure]", **facts: Any) -> list[Path]:  # noqa: ANN401
    """Write the page of the template of its name, and the same as HTML; return both."""
    return write_beside(path, render(path.stem, **facts), figures)


def releases(*packages: str) -> str:
    """`spikedeploy 0.1, torch 2.13`."""
    return ", ".join(
        [f"spikedeploy {own()}", *(f"{name} {installed_version(name)}" for name in packages)]
    )


def versions_text(found: Mapping[str, object]) -> str:
    """`python 3.11.7, torch 2.13.0, numpy 2.4.6`, of a record of versions."""
    return ", ".join(f"{name} {found.get(name)}" for name in ("python", "torch", "numpy"))


def versions_at_start(records: Iterable[str]) -> list[str]:
    """A line on the versions when trainings began, and of how many; the most frequent first.

    records  of each training, as `versions_text` has them; without any there is no line
    """
    found = Counter(records).most_common()
    texts = [f"{versions} ({count} trainings)" for versions, count in found]
    return [f"- versions when a training began: {'; '.join(texts)}"] if texts else []


def command(design: Design, *names: str, sizes: Sequence[str] = ()) -> str:
    """The command that makes a page, with the sizes that are named and other than usual."""
    words = ["python", "-m", "lab", "experiment", design.NAME, *names]
    words += ["--quick"] if design.quick else []
    for size in sizes:
        words += [f"--{size.replace('_', '-')}", f"{getattr(design, size)}"]
    words += ["--chip", design.chip] if design.chip != "loihi1" else []
    return shlex.join(words)


def with_settings(text: str, settings: Iterable[str]) -> str:
    """A command with a --set for each setting."""
    return " ".join([text, *(f"--set {shlex.quote(each)}" for each in settings)])


def other_settings(trainings: Iterable[TrainingJob], text: str) -> list[str]:
    """A line for each training whose settings are not those of its recipe now."""
    return [
        f"- {text.format(training.name)}{', '.join(changed)}"
        for training in trainings
        if training.is_trained and (changed := training.changed_settings)
    ]


CHANGED = "✗ {} was trained with other settings than its recipe has now: "


def missing_text(notes: Sequence[str], limit: int | None) -> str:
    """What is missing, in bold; of quick trials that they are.

    limit: control steps of an episode; None for all
    """
    steps = f"{limit} control steps"
    quick = f"A quick trial, whose episodes end after {steps}: its scores say nothing."
    every = [*notes, *([quick] if limit else [])]
    return f"**{' '.join(every)}**" if every else ""


def grouped(rows: Iterable[Record], *fields: str) -> Iterator[tuple[Any, list[Record]]]:
    """Rows that agree in these fields, in the order of the first of each."""
    found: dict[Any, list[Record]] = {}
    for row in rows:
        key = tuple(row.get(name) for name in fields)
        found.setdefault(key[0] if len(key) == 1 else key, []).append(row)
    yield from found.items()


def mean(rows: Iterable[Record], field: str) -> float | None:
    """Mean of a field; None where no row has it."""
    found = [row[field] for row in rows if row.get(field) is not None]
    return float(np.mean(found)) if found else None


def number(value: float | None, form: str = ",.0f") -> str:
    """A number, or a dash where there is none."""
    return ABSENT if value is None else format(value, form)


def pico(joules: float) -> str:
    """An energy in pJ."""
    return format(joules * PICO, ",.0f")


def share(score: Estimate | None) -> str:
    """`99.5% [99.2%, 99.8%]`; a dash where there is none, or its reference scores nothing."""
    if score is None or math.isnan(score.mean):
        return ABSENT
    low, high = score.ci95
    return f"{score.mean:.1%}" + ("" if math.isnan(low) else f" [{low:.1%}, {high:.1%}]")


def estimate(found: Estimate | None, form: str) -> str:
    """`3,438 [3,430, 3,446]`; a dash where there is none."""
    return ABSENT if found is None else found.text(form)


def percent(found: Estimate, digits: int = 0) -> str:
    """`97% [95, 99]`."""
    low, high = (f"{100 * bound:.{digits}f}" for bound in found.ci95)
    return f"{found.mean:.{digits}%} [{low}, {high}]"


def plain(axes: "Axes", which: Literal["major", "both"] = "major") -> None:
    """Leave the axes their left and lower line, and a grid behind what is drawn."""
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(color="#E6E8EB", which=which)
    axes.set_axisbelow(True)


_TEMPLATES.filters |= {
    "table": markdown_text, "number": number, "pico": pico, "share": share, "estimate": estimate,
    "percent": percent, "form": format,
}  # fmt: skip
