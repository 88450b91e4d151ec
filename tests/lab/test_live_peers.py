"""`./spike test --peers`: which tools it compares with, and what it says of them."""

import subprocess
import sys
from pathlib import Path

import pytest

from lab.peers import live_peers
from lab.peers.kits import CASES
from lab.peers.live_peers import PEERS, requirements
from tests.paths import ROOT

NAMES = [
    "brian2-loihi",
    "lava",
    "nengo-loihi",
    "neurobench",
    "norse",
    "sanafe",
    "snntorch",
    "spikingjelly",
]


def test_every_tool_that_we_claim_to_equal_is_compared_with():
    assert {*NAMES} <= {peer.name for peer in PEERS}
    assert all(peer.tests or peer.traces or peer.kits for peer in PEERS)
    assert {peer.name for peer in PEERS if peer.kits} == set(CASES)


@pytest.mark.parametrize("peer", PEERS, ids=lambda peer: peer.name)
def test_a_peer_is_installed_in_the_release_that_it_was_compared_with(peer):
    wanted = requirements(peer)
    pinned = [each for each in wanted if "==" in each]
    assert pinned[0].startswith(peer.name)
    # importing samna runs an installer; sinabs and rockpool ask for it, and leave it unloaded
    assert "samna" not in " ".join(wanted)
    asks = peer.name in ("sinabs", "rockpool")
    assert asks == ("--no-deps" in wanted)
    assert all((ROOT / word).is_file() for word in peer.tests if word.endswith(".py"))


@pytest.fixture
def played(monkeypatch, capsys, tmp_path):
    """Run the script for one peer, with pip or the comparison replaced; its exit code and line."""

    def play(**replaced):
        for name, function in replaced.items():
            monkeypatch.setattr(live_peers, name, function)
        monkeypatch.setattr(sys, "argv", ["live_peers.py", "norse", "--folder", str(tmp_path)])
        code = live_peers.main()
        return code, capsys.readouterr().out

    return play


def test_a_peer_that_cannot_be_installed_is_named_with_the_reason_and_is_no_failure(played):
    def fails(command):
        error = [sys.executable, "-c", "raise SystemExit('ERROR: no such release')"]
        return live_peers_called(error if "pip" in command else command)

    live_peers_called = live_peers.run_command
    code, out = played(run_command=fails)
    assert (code, out) == (0, "- norse         could not be installed: ERROR: no such release\n")


@pytest.mark.parametrize(
    ("body", "code", "says"),
    [
        ("def test_a(): pass", 0, "✓ norse         tests: 1 passed\n"),
        ("def test_a(): pass\ndef test_b(): assert 0", 1, "✗ norse         tests: 1 passed, 1 fai"),
        (
            "import pytest\ndef test_a(): pytest.skip('no norse')",
            1,
            "0 passed, 1 skipped: no norse",
        ),
        ("import nothing_like_this", 1, "✗ norse         tests: 0 passed, 1 failed, see "),
    ],
    ids=["passes", "fails", "skips", "does not start"],
)
def test_a_line_says_what_came_of_the_comparison(body, code, says, played, tmp_path):
    (tmp_path / "norse").mkdir()
    (tmp_path / "test_it.py").write_text(body)

    def run(command, log):
        # the options of pyproject.toml are not read there, so nengo's plugin is refused here too
        words = [*command[:4], str(tmp_path / "test_it.py"), "-c", "/dev/null", "-p", "no:nengo"]
        log.write_text("")
        done = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, check=False)
        return done.returncode, done.stdout.splitlines()

    found = played(environment=lambda peer, home: Path(sys.executable), run=run)
    assert found[0] == code
    assert says in found[1]
