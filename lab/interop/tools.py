"""Tools that open NIR files, and the Pythons in which they are installed."""

import json
import subprocess
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

from spikedeploy.runtime.errors import ConfigError

_SCRIPT = Path(__file__).with_name("peer_process.py")
_SECONDS = 600  # for all jobs of one call
_RELEASES = ("1.0.1", "1.0.4", "1.0.5", "1.0.6", "1.0.7", "1.0.8")


@dataclass(frozen=True)
class OtherTool:
    """A tool.

    name      of its environment
    title     in words
    importer  whether it computes spikes, and `export --for` knows it
    missing   why it is never run; empty where it is
    """

    name: str
    title: str
    importer: bool = False
    missing: str = ""

    @property
    def release(self) -> str:
        """The release of nir that it is; empty for other tools."""
        return self.name.removeprefix("nir==") if self.name.startswith("nir==") else ""


PEERS = (
    OtherTool("norse", "Norse", importer=True),
    OtherTool("snntorch", "snnTorch", importer=True),
    OtherTool("spikingjelly", "SpikingJelly", importer=True),
    OtherTool("rockpool", "Rockpool", importer=True),
    OtherTool(
        "sinabs", "sinabs", missing="not opened here: it asks for an older `nir`, and for samna"
    ),
    OtherTool("snn-mlir", "snn-mlir check"),
    *(OtherTool(f"nir=={release}", f"nir {release}") for release in _RELEASES),
)


def pythons(folder: Path, given: Mapping[str, Path]) -> dict[str, Path]:
    """The Python of each tool that has one: given by name, else FOLDER/NAME/bin/python."""
    names = [peer.name for peer in PEERS]
    for name, place in given.items():
        if name not in names:
            raise ConfigError(f"--python {name}: there are {', '.join(names)}")
        if not place.exists():
            raise ConfigError(f"--python {name}: there is no {place}")
    own = f"nir=={version('nir')}"
    places = {name: folder / name / "bin" / "python" for name in names} | dict(given)
    usual = {own: Path(sys.executable)} if own in names else {}
    return usual | {n: p.absolute() for n, p in places.items() if p.exists()}


def check_given(given: Mapping[str, Path]) -> None:
    """Refuse a path of --python that is no Python in which its tool is installed."""
    for peer in PEERS:
        if peer.name in given and not peer.missing and not versions(peer, given[peer.name]):
            raise ConfigError(
                f"--python {peer.name}={given[peer.name]} is not a Python with {peer.name}. Name "
                "the one in which it is installed."
            )


def versions(peer: OtherTool, python: Path) -> dict[str, str]:
    """Releases of the packages that a tool reads files with; empty where it is not installed."""
    try:
        found = json.loads(_output([str(python), str(_SCRIPT), peer.name, "versions"], "", 60))
    except (OSError, ValueError, RecursionError):
        return {}
    named = isinstance(found, dict) and all(isinstance(each, str) for each in found.values())
    return found if named else {}


def answers(peer: OtherTool, python: Path, jobs: list[dict[str, Any]]) -> Iterator[dict[str, Any]]:
    """The tool's answer to each job, in their order."""
    command = [str(python), str(_SCRIPT), peer.name]
    lines = _output(command, json.dumps(jobs), _SECONDS).splitlines()
    yield from map(json.loads, lines)
    for _ in jobs[len(lines) :]:
        yield {"opens": False, "message": "its process ended, or took too long"}


def _output(command: list[str], given: str, seconds: float) -> str:
    """The stdout of a process until it ended, or until its time was over."""
    try:
        done = subprocess.run(
            command, input=given, capture_output=True, text=True, check=False, timeout=seconds
        )
    except subprocess.TimeoutExpired as error:
        written = error.stdout or ""
        return written.decode() if isinstance(written, bytes) else written
    return done.stdout
