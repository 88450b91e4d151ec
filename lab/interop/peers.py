"""Tools that open NIR files, and the Pythons in which they are installed."""

import json
import subprocess
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from spikedeploy.runtime.errors import ConfigError

_SCRIPT = Path(__file__).with_name("peer_process.py")
_SECONDS = 600  # for all jobs of one call
_RELEASES = ("1.0.1", "1.0.4", "1.0.5", "1.0.6", "1.0.7", "1.0.8")


@dataclass(frozen=True)
class OtherTool:
    """A tool.

    name: of its environment.
    title: for people.
    importer: whether it computes spikes, and `export --for` knows it.
    missing: why it is never run; empty where it is.
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
    """The Python of each peer that has one: given by name, else FOLDER/NAME/bin/python."""
    if unknown := sorted(given.keys() - {peer.name for peer in PEERS}):
        names = ", ".join(peer.name for peer in PEERS)
        raise ConfigError(f"--python {unknown[0]}: there are {names}")
    places = {peer.name: folder / peer.name / "bin" / "python" for peer in PEERS}
    found = {name: given.get(name, place) for name, place in places.items()}
    for name, place in given.items():
        if not place.exists():
            raise ConfigError(f"--python {name}: there is no {place}")
    own = f"nir=={_own_release()}"
    usual = {own: Path(sys.executable)} if own in places else {}
    return {**usual, **{n: p.absolute() for n, p in found.items() if p.exists()}}


def versions(peer: OtherTool, python: Path) -> dict[str, str]:
    """Releases of the packages that a peer reads files with; empty where it is not installed."""
    command = [str(python), str(_SCRIPT), peer.name, "versions"]
    try:
        done = subprocess.run(
            command, capture_output=True, check=False, stdin=subprocess.DEVNULL, timeout=60
        )
        found = json.loads(done.stdout) if done.returncode == 0 else {}
    except (OSError, subprocess.TimeoutExpired, ValueError, RecursionError):
        return {}
    named = isinstance(found, dict) and all(isinstance(each, str) for each in found.values())
    return found if named else {}


def check_given(given: Mapping[str, Path]) -> None:
    """Refuse a path of --python that is no Python in which its tool is installed."""
    for peer in PEERS:
        if peer.name in given and not peer.missing and not versions(peer, given[peer.name]):
            place = given[peer.name]
            raise ConfigError(
                f"--python {peer.name}={place} is not a Python with {peer.name}. Name the one in "
                "which it is installed."
            )


def answers(peer: OtherTool, python: Path, jobs: list[dict[str, Any]]) -> Iterator[dict[str, Any]]:
    """What the peer says to each job, in their order."""
    done = _called([str(python), str(_SCRIPT), peer.name], json.dumps(jobs))
    lines = [json.loads(line) for line in done.splitlines()]
    yield from lines
    for _ in jobs[len(lines) :]:
        yield {"opens": False, "message": "its process ended, or took too long"}


def _called(command: list[str], jobs: str) -> str:
    """What a peer printed until it ended, or until its time was over."""
    try:
        done = subprocess.run(
            command, input=jobs, capture_output=True, text=True, check=False, timeout=_SECONDS
        )
    except subprocess.TimeoutExpired as error:
        said = error.stdout or ""
        return said.decode() if isinstance(said, bytes) else said
    return done.stdout


def _own_release() -> str:
    from importlib.metadata import version

    return version("nir")
