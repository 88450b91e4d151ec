"""The comparisons with other tools, each tool in an environment of its own: `./spike test --peers`.

    python -m lab live-peers [NAME …] [--folder .venv-peers]

Each tool gets a virtual environment, FOLDER/NAME, in the release that pyproject.toml pins. There
its golden traces are recorded again, random networks of several layers run on emulators of Loihi
and are replayed here, and the tests that compare with it run; `python -m lab interop` finds it
there. A line for each says what came of it; a tool that cannot be installed is named with the
reason. Exits with 1 where a comparison fails.

samna is never installed here, and rockpool and sinabs without what they depend on: importing samna
runs an installer. `import sinabs` leaves it unloaded.
"""

import argparse
import os
import shutil
import subprocess
import sys
import sysconfig
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from xml.etree import ElementTree

from lab.peers.record_traces import NOTHING_RECORDED, SOURCES
from spikedeploy.runtime.traces.verify import verify

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).parents[2]
FAMILIES, METRICS = "tests/runtime/families", "tests/runtime/metrics"
PRESETS, EXPORTS = "tests/runtime/test_peers.py", "tests/runtime/test_peer_exports.py"
ADAPTERS = "tests/trainers/test_other_libraries.py"
MODELS = "tests/trainers/test_public_models.py"
INTEROP = "tests/lab/interop/test_peer_process.py"
EXAMPLES = "tests/spikedeploy/commands/test_check_against.py"
RANDOM_NETWORKS = 10


@dataclass(frozen=True)
class Peer:
    """A tool that we compare with.

    tests: what pytest runs in its environment.
    traces: module of lab/peers/traces that records its golden traces again.
    kits: whether the kits of `export --to program` run in it (lab/peers/kits.py).
    options: of pip, beside the requirements of the extra of its name.
    python: its version of Python, where it needs another; it then shares nothing with ours.
    """

    name: str
    tests: tuple[str, ...] = ()
    traces: str | None = None
    kits: bool = False
    options: tuple[str, ...] = ()
    python: str | None = None


PEERS = (
    Peer("snntorch", (PRESETS, EXPORTS, EXAMPLES, INTEROP, "-k", "snntorch")),
    Peer("norse", (PRESETS, EXPORTS, EXAMPLES, ADAPTERS, MODELS, INTEROP, "-k", "norse")),
    Peer("spikingjelly", (PRESETS, EXPORTS, EXAMPLES, ADAPTERS, INTEROP, "-k", "spikingjelly")),
    Peer("nengo", (PRESETS, "-k", "nengo")),
    Peer("neurobench", (f"{METRICS}/test_neurobench_peer.py",)),
    Peer("sanafe", (f"{METRICS}/test_sanafe.py",), traces="sanafe"),
    Peer("xylosim", (f"{FAMILIES}/test_xylosim.py",), traces="xylosim", kits=True),
    Peer(
        "sinabs",
        (f"{FAMILIES}/test_sinabs_peer.py", ADAPTERS, "-k", "sinabs"),
        kits=True,
        options=("--no-deps", "sinabs==3.1.3", "nirtorch==2.6", "pbr"),
    ),
    Peer(
        "rockpool",
        (f"{FAMILIES}/test_rockpool_quantisers.py", INTEROP, "-k", "rockpool"),
        options=("--no-deps", "rockpool==3.1.0", "nirtorch==2.6", "scipy"),
    ),
    Peer("snn-mlir", (INTEROP, "-k", "snn_mlir")),
    # releases of nir that are no longer the newest, for files that older tools open
    *(
        Peer(f"nir=={release}", (INTEROP, "-k", f"nir-{release}"), options=(f"nir=={release}",))
        for release in ("1.0.1", "1.0.4", "1.0.5", "1.0.6", "1.0.7")
    ),
    Peer("nengo-loihi", traces="nengo_loihi", kits=True),
    Peer("brian2-loihi", traces="brian2_loihi"),
    Peer("lava", traces="lava", kits=True, python="3.10"),
)


class NotInstalledError(Exception):
    """A tool that cannot be installed here; the message says why."""


def main() -> int:
    """Compare with each peer, print a line for each; return the exit code."""
    arguments = parse_options()
    failed = False
    for peer in PEERS:
        if arguments.names and peer.name not in arguments.names:
            continue
        home = arguments.folder.resolve() / peer.name
        try:
            python = environment(peer, home)
        except NotInstalledError as error:
            print(f"- {peer.name:13} could not be installed: {error}", flush=True)
            continue
        verdicts = list(compare(peer, python, home))
        well = all(passed for passed, _ in verdicts)
        failed |= not well
        texts = "; ".join(text for _, text in verdicts)
        print(f"{'✓' if well else '✗'} {peer.name:13} {texts}", flush=True)
    return 1 if failed else 0


def environment(peer: Peer, home: Path) -> Path:
    """Python of the peer's environment, installed if it is not there yet."""
    python, wanted = home / "bin" / "python", " ".join(requirements(peer))
    done = home / "requirements.txt"
    if python.exists() and done.exists() and done.read_text() == wanted:
        return python
    shutil.rmtree(home, ignore_errors=True)
    run_command([interpreter(peer), "-m", "venv", str(home)])
    kept = home / "constraints.txt"
    kept.write_text("" if peer.python else share_packages(home))
    command = [str(python), "-m", "pip", "install", "-c", str(kept), *requirements(peer)]
    (home / "install.log").write_text(run_command(command))
    done.write_text(wanted)
    return python


def share_packages(home: Path) -> str:
    """Let an environment see the packages beside us; those that it must not install anew.

    What is installed in it comes first. A torch of its own would be several gigabytes.
    """
    beside = next(home.glob("lib/python*/site-packages")) / "beside.pth"
    beside.write_text(f"import site; site.addsitedir({sysconfig.get_path('purelib')!r})\n")
    return f"torch=={version('torch').partition('+')[0]}\n" if find_spec("torch") else ""


def requirements(peer: Peer) -> list[str]:
    """Requirements for pip: the options, and the extra of the peer's name."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    return [*peer.options, *project["optional-dependencies"].get(peer.name, ())]


def interpreter(peer: Peer) -> str:
    """A Python of the version that the peer needs."""
    names = [sys.executable] if peer.python is None else [sys.executable, f"python{peer.python}"]
    test = "import sys; print('%d.%d' % sys.version_info[:2])"
    for name in filter(shutil.which, names):
        # a shim of pyenv is there and does not run
        done = subprocess.run([name, "-c", test], capture_output=True, text=True, check=False)
        if done.stdout.strip() == (peer.python or done.stdout.strip()):
            return name
    raise NotInstalledError(f"it needs Python {peer.python}, and there is no python{peer.python}")


def run_command(command: list[str]) -> str:
    """Output of a command of the installation."""
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        lines = [line for line in done.stderr.splitlines() if "ERROR" in line.upper()]
        lines = lines or done.stderr.splitlines() or ["no reason is given"]
        raise NotInstalledError(lines[-1].strip())
    return done.stdout


def compare(peer: Peer, python: Path, home: Path) -> Iterator[tuple[bool, str]]:
    """Yield whether each comparison passed, and what it says."""
    if peer.traces:
        yield record_again(peer.traces, python, home)
    if peer.traces in SOURCES:
        yield replay_random(peer.traces, python, home)
    if peer.kits:
        words = ["lab", "kits", peer.name, "--python", str(python), "--folder", str(home / "kits")]
        code, lines = run([sys.executable, "-m", *words], home / "kits.log")
        yield code == 0, "; ".join(["kits: " + lines[-1], *(x for x in lines if x[:1] == "✗")])
    if peer.tests:
        yield run_tests(peer.tests, python, home)


def record_again(tool: str, python: Path, home: Path) -> tuple[bool, str]:
    """Record the golden traces of the tool again."""
    words = [str(python), "-m", "lab", "record-traces", "--tool", tool]
    code, lines = run(words, home / "traces.log")
    if code == NOTHING_RECORDED:
        return False, lines[0].removeprefix("- ")
    return code == 0, "; ".join(["traces: " + lines[-1], *(x for x in lines if x[:1] in "✗-")])


def replay_random(tool: str, python: Path, home: Path) -> tuple[bool, str]:
    """Record random networks of several layers with the tool, and replay them with ours."""
    folder = home / "random"
    shutil.rmtree(folder, ignore_errors=True)
    words = ["--random", str(RANDOM_NETWORKS), "--tool", tool, "--out", str(folder)]
    code, _ = run([str(python), "-m", "lab", "record-traces", *words], home / "random.log")
    if code:
        return False, f"random networks: not recorded, see {home / 'random.log'}"
    verdicts = [verify(path) for path in sorted(folder.glob("*.json"))]
    bad = sum(verdict.difference is not None for verdict in verdicts)
    numbers = sum(verdict.compared for verdict in verdicts)
    text = f"random networks: {len(verdicts) - bad} equal, {numbers:,} numbers"
    return not bad and bool(verdicts), text + (f"; {bad} different" if bad else "")


def run_tests(tests: tuple[str, ...], python: Path, home: Path) -> tuple[bool, str]:
    """Run tests that compare with the tool; none that is skipped counts as passed."""
    report = home / "tests.xml"
    report.unlink(missing_ok=True)
    run([str(python), "-m", "pytest", f"--junitxml={report}", *tests], home / "tests.log")
    if not report.exists():
        return False, f"tests: did not run, see {home / 'tests.log'}"
    suite = next(ElementTree.parse(report).iter("testsuite"))
    total, skipped = int(suite.get("tests", 0)), int(suite.get("skipped", 0))
    bad = int(suite.get("failures", 0)) + int(suite.get("errors", 0))
    text = f"tests: {total - skipped - bad} passed"
    if bad:
        text += f", {bad} failed, see {home / 'tests.log'}"
    if skipped:
        reasons = {each.get("message", "") for each in suite.iter("skipped")}
        text += f", {skipped} skipped: {'; '.join(sorted(reasons))}"
    return not bad and total > skipped, text


def run(command: list[str], log: Path) -> tuple[int, list[str]]:
    """Run a command in the checkout; return its exit code and lines, which a file has too."""
    environ = {**os.environ, "PYTHONDONTWRITEBYTECODE": "1"}
    done = subprocess.run(
        command, cwd=ROOT, env=environ, capture_output=True, text=True, check=False
    )
    log.write_text(done.stdout + done.stderr)
    return done.returncode, done.stdout.splitlines() or [f"nothing was said, see {log}"]


def parse_options() -> argparse.Namespace:
    """Return the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    names = [peer.name for peer in PEERS]
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(names)}")
    parser.add_argument("--folder", type=Path, default=ROOT / ".venv-peers")
    arguments = parser.parse_args()
    if unknown := set(arguments.names) - set(names):
        parser.error(f"{', '.join(sorted(unknown))}: there are {', '.join(names)}")
    return arguments
