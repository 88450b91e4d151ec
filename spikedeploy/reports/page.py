"""Pages: HTML files that need nothing else, in light and dark, on phones and on paper.

`templates` has a template of each page and of its parts; `assets` their style and scripts.
"""

import shlex
import sys
from collections.abc import Callable, Mapping
from datetime import datetime, timezone
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

from spikedeploy.outputs import has_text
from spikedeploy.runtime.files import as_text, write_text
from spikedeploy.trainers.versions import own

if TYPE_CHECKING:
    from jinja2 import Environment

# what replays recorded episodes
REPLAY_ASSETS = ("unpack.js", "bodies.js", "track.js", "maps.js", "film.js", "strips.js",
                 "instrument.js")  # fmt: skip
FILES = ("report.html", "report.json")


def render(template: str, **content: Any) -> str:  # noqa: ANN401
    """The page of a template; text in `content` is escaped, Markup is not."""
    return _environment().get_template(f"{template}.html.j2").render(content)


def asset(name: str) -> str:
    """A style or script of the pages."""
    return files("spikedeploy.reports").joinpath("assets").joinpath(name).read_text("utf-8")


@cache
def _environment() -> "Environment":
    from jinja2 import Environment, PackageLoader, StrictUndefined

    made = Environment(
        loader=PackageLoader("spikedeploy.reports"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    made.globals.update(asset=asset, replay_assets=REPLAY_ASSETS, lead="", reload=0, poster=0)
    made.policies["json.dumps_kwargs"] = {"allow_nan": False}
    return made


# the folder of a page


def command_line() -> str:
    """The command that this process runs, as it can be typed again."""
    return shlex.join(["spikedeploy", *sys.argv[1:]])


def provenance() -> list[tuple[str, str]]:
    """The origin of a page: version, time, command line."""
    now = datetime.now(timezone.utc).isoformat(timespec="seconds")
    return [("made by", f"spikedeploy {own()}, {now}"), ("command line", command_line())]


def write_page(command: str, html: str, numbers: Mapping[str, Any], folder: Path) -> list[Path]:
    """Write the page of a command and its numbers; return both files."""
    made = {"report_of": command, **dict(provenance()), **numbers}
    return [
        write_text(folder / "report.html", html),
        write_text(folder / "report.json", as_text(made)),
    ]


def is_page_of(command: str) -> Callable[[Path], bool]:
    """A test of folders: whether an earlier run of this command wrote its page there."""
    return lambda folder: has_text(folder / "report.json", f'"report_of": "{command}"')
