"""host.py, alone in its folder, acts through a port as the emulator acts, to the last bit."""

import json
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from spikedeploy import zoo
from spikedeploy.exporters.verilog.board_files import host_record
from spikedeploy.exporters.verilog.boards import board
from spikedeploy.runtime.artifact.artifact import Artifact, load
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.codec.codec import Codec, DeltaEncoder, Normaliser
from spikedeploy.runtime.codec.events import EventEncoder
from spikedeploy.runtime.codec.rate import RateEncoder
from spikedeploy.runtime.compiler.compile import own_clock
from spikedeploy.runtime.convention import CLOCKS, Convention
from spikedeploy.runtime.emulator.controllers import SpikingController
from tests import readouts
from tests.board_designs import export, host_module, image_of, scripts, walk
from tests.emulated_board import EmulatedBoard, FilePort
from tests.networks import event_driven, popsan, with_last

HOST, LINK = host_module(), scripts().link


def with_codec(artifact, encoder, squash="tanh"):
    """A policy with random weights, and another encoder of as many spikes."""
    size = encoder.observed
    normaliser = Normaliser(np.zeros(size), np.ones(size), 9.0)
    codec = Codec(normaliser, encoder, artifact.codec.timesteps, squash)
    return Artifact(artifact.graph, codec, artifact.convention, artifact.provenance)


def rate_coded(mode):
    policy = popsan(obs=3, populations=4)
    return with_codec(policy, RateEncoder(np.full(12, -1.0), np.ones(12), mode))


def event_coded(code, most=1):
    size = 24 // (most if code == "channels" else 1)
    policy = popsan(obs=3, populations=8)
    return with_codec(policy, EventEncoder(size, 2, most, code), "argmax")


def onto_readouts(kind, delay=0):
    """A delta code before a network whose membranes leave the core."""
    source = readouts.network(kind)
    encoder = DeltaEncoder(np.full(3, 0.2), most=2)
    normaliser = Normaliser(np.array([0.0, 2.0, -1.0]), np.array([1.0, 3.0, 0.2]), 4.0)
    convention = Convention(readouts.DT, delay=delay, state="kept")
    return Artifact(source.graph, Codec(normaliser, encoder, 1 + 2 * delay), convention)


POLICIES = {
    "population": popsan,
    "rate": lambda: rate_coded("regular"),
    "random": lambda: rate_coded("bernoulli"),
    "channels": lambda: event_coded("channels", 3),
    "spread": lambda: event_coded("spread", 4),
    "unary": event_driven,
    "one-hot, three timesteps": lambda: event_driven(code="one-hot", timesteps=3),
    "the last of three": lambda: with_last(onto_readouts("second", delay=1)),
    "membranes": lambda: onto_readouts("same"),
    "two readouts": lambda: onto_readouts("second"),
    "readouts, late": lambda: onto_readouts("second", delay=1),
}


def controller_of(artifact):
    """The emulated chip, whose layers are updated when they are told to."""
    told = replace(chip("loihi1"), clocks=CLOCKS)
    return SpikingController(artifact, told, clock=own_clock(artifact.convention))


def policy_at(port, artifact, image, seconds=10.0):
    """host.py's policy at a port, which waits so long for an answer."""
    record = host_record(image.program, artifact.codec, image, board("icebreaker"), "a test")
    record = json.loads(json.dumps(record, allow_nan=False))
    sizes = (record["link"][name] for name in ("tokens", "words", "timestep"))
    return HOST.Policy(LINK.Link(port, *sizes, seconds, tries=30), record)


def check_actions(artifact, steps=12, lose=0.0):
    """Two episodes on a board have the emulator's actions; the requests that were repeated."""
    image, controller = image_of(artifact), controller_of(artifact)
    with EmulatedBoard(image, lose) as emulated:
        port = FilePort(emulated.path)
        policy = policy_at(port, artifact, image, 0.1 if lose else 10.0)
        for seed in (3, 4):
            controller.reset(seed)
            policy.reset(seed)
            for row in walk(artifact.codec, steps, seed):
                assert np.array_equal(policy.act(row), controller.act(row))
        port.close()
    return policy.link.repeated


@pytest.mark.parametrize("name", POLICIES)
def test_actions_are_the_emulators_with_each_code(name):
    assert check_actions(POLICIES[name]()) == 0


@pytest.mark.parametrize("name", ["hexapod/sparse", "kart-steer/sparse-gated"])
def test_actions_are_the_emulators_of_shipped_policies(name):
    check_actions(load(zoo.path(name)), 8)


def test_requests_that_are_lost_and_replies_that_are_damaged_change_no_action():
    assert check_actions(event_driven(timesteps=2), 20, lose=0.1) > 0


def test_an_observation_of_another_size_or_not_finite_is_refused():
    artifact = event_driven()
    image = image_of(artifact)
    with EmulatedBoard(image) as emulated:
        port = FilePort(emulated.path)
        policy = policy_at(port, artifact, image)
        for wrong in ([0.0, 0.0], [0.0, np.nan, 0.0]):
            with pytest.raises(ValueError, match="an observation has 3 finite numbers"):
                policy.act(wrong)
        port.close()


class Forgetful:
    """A port to a board that answers each request, and computes nothing."""

    timeout = None

    def write(self, data):
        self._reply = LINK.reply(data[1], [])
        return len(data)

    def read(self, size=1):
        found, self._reply = self._reply, b""
        return found


def test_a_board_that_answers_without_words_is_an_error_and_no_action():
    artifact = event_driven(timesteps=2)
    image = image_of(artifact)
    policy = policy_at(Forgetful(), artifact, image)
    with pytest.raises(LINK.LinkError, match="answered 0 words to 2 timesteps of 1 words each"):
        policy.act(walk(artifact.codec, 1)[0])


def test_host_runs_alone_in_its_folder_and_names_what_differs(tmp_path):
    pytest.importorskip("serial", reason="pyserial is not installed")
    artifact = event_driven()
    image = export(artifact, "icebreaker", tmp_path)

    def run(path):
        words = [sys.executable, tmp_path / "host.py", path]
        return subprocess.run(words, capture_output=True, text=True, check=False)

    with EmulatedBoard(image) as emulated:
        done = run(emulated.path)
        assert (done.returncode, done.stderr) == (0, "")
        assert done.stdout.startswith("equal: 40 actions; ")
        episode = json.loads((tmp_path / "episode.json").read_text())
        episode["action"][7][0] += 1e-15
        (tmp_path / "episode.json").write_text(json.dumps(episode))
        done = run(emulated.path)
        assert (done.returncode, done.stdout[:24]) == (1, "differs: control step 7:")
    assert "cannot be opened" in run("/dev/none").stderr
    assert "import spikedeploy" not in (tmp_path / "host.py").read_text()
