"""`run FILE --from TOOL`: a network of another tool drives, read as its author meant it."""

import json
import shutil

import nir
import numpy as np
import pytest

import spikedeploy as sd
from tests.networks import chain
from tests.paths import ROOT

EXPORTS = ROOT / "tests/golden/exports"
ENV = ("--env", "tests.own_env:Dials")
CODEC = {
    "timesteps": 8,
    "squash": "argmax",
    "normaliser": {"mean": [0] * 12, "std": [1.0] * 12, "clip": 3},
    "encoder": {"kind": "rate", "mode": "regular", "low": [-1] * 12, "high": [1] * 12},
}


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("snntorch_leaky", "norse_lifcell", "spikingjelly_lif"):
        shutil.copy(EXPORTS / f"{name}.nir", tmp_path)
    (tmp_path / "codec.json").write_text(json.dumps(CODEC))
    return tmp_path


@pytest.mark.parametrize(
    ("name", "recorded", "options"),
    [
        ("snntorch_leaky", "snntorch_leaky_default", ()),
        ("snntorch_leaky", "snntorch_leaky_zero", ("--reset", "zero")),
        ("norse_lifcell", "norse_lifcell", ()),
        ("spikingjelly_lif", "spikingjelly_lif", ()),
    ],
)
def test_a_network_of_another_tool_drives_and_spikes_as_its_author_meant(
    name, recorded, options, here, command
):
    tool = name.partition("_")[0]
    words = (f"{name}.nir", "--from", tool, "--codec", "codec.json", *ENV, "--chip", "float")
    code, out, err = command("run", *words, *options, "--json")
    assert code == 0, err
    assert "not in the file, so assumed" in err
    assert ("--reset" in err.partition("not in the file")[2]) == (
        tool != "spikingjelly" and not options
    )
    assert f"wrote {name}.policy.nir" in err
    assert json.loads(out)["rows"][0]["chip"] == "float"
    kept = f"{name}.policy.nir"
    code, out, _ = command("check", kept, "--against", EXPORTS / f"{recorded}.npz")
    assert "your framework = our float: equal" in out


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--from", "snntorch"), "give --codec FILE.json"),
        (("--from", "snntorc", "--codec", "codec.json"), "snntorc"),
        (("--codec", "codec.json"), "--codec goes with --from"),
        (("--reset", "zero"), "--reset goes with --from"),
        (("--from", "snntorch", "--codec", "snntorch_leaky.nir"), "is damaged"),
        (("--from", "snntorch", "--codec", "list.json"), "list.json"),
        (
            ("--from", "snntorch", "--codec", "short.json"),
            "incomplete; docs/own-network",
        ),
        (
            ("--from", "snntorch", "--codec", "narrow.json"),
            "makes 2 spike trains, node 'input' takes 12. Change the encoder, or give a network "
            "with 2 inputs.",
        ),
    ],
)
def test_what_is_missing_is_asked_for(words, said, here, command):
    (here / "list.json").write_text("[1]")
    (here / "short.json").write_text('{"timesteps": 4}')
    narrow = {
        "normaliser": {"mean": [0] * 2, "std": [1.0] * 2, "clip": 3},
        "encoder": {**CODEC["encoder"], "low": [-1] * 2, "high": [1] * 2},
    }
    (here / "narrow.json").write_text(json.dumps({**CODEC, **narrow}))
    code, out, err = command("run", "snntorch_leaky.nir", *ENV, *words)
    assert code == 2
    assert out == ""
    assert said in " ".join(err.split())


def test_a_file_of_somebody_else_is_kept_and_ones_own_is_written_again(here, command):
    words = ("run", "norse_lifcell.nir", "--from", "norse", "--codec", "codec.json")
    target = here / "norse_lifcell.policy.nir"
    shutil.copy(EXPORTS / "snntorch_leaky.nir", target)
    before = target.read_bytes()
    code, _, err = command(*words, *ENV, "--chip", "float")
    assert code == 2
    assert "--force" in err
    assert target.read_bytes() == before
    for force in (("--force",), ()):
        assert command(*words, *ENV, "--chip", "float", *force)[0] == 0
    assert target.read_bytes() != before


def test_what_no_chip_takes_leaves_the_policy_of_before(here, command):
    words = ("snntorch_leaky.nir", "--from", "snntorch", "--codec", "codec.json", *ENV)
    assert command("run", *words, "--reset", "zero", "--json")[0] == 0
    before = (here / "snntorch_leaky.policy.nir").read_bytes()
    code, _, err = command("run", *words, "--chip", "loihi1")
    assert code == 1
    assert "rule reset" in err
    assert (here / "snntorch_leaky.policy.nir").read_bytes() == before


def test_rates_of_a_spiking_last_layer_become_actions_in_bounds(here, command):
    full = lambda *values: [np.full(1, float(value)) for value in values]  # noqa: E731
    nodes = [nir.Linear(np.ones((1, 3))), nir.LIF(*full(2e-3, 2, 0, 0.5), v_reset=np.zeros(1))]
    nir.write(here / "mine.nir", chain(*nodes, width=3, act=1))
    coded = {
        "timesteps": 8,
        "squash": "none",
        "normaliser": {"mean": [0] * 3, "std": [1, 1, 8], "clip": 1},
        "encoder": {"kind": "rate", "mode": "regular", "low": [-1] * 3, "high": [1] * 3},
    }
    words = ("run", "mine.nir", "--dt", "1e-3", "--codec", "codec.json", "--env", "Pendulum-v1")
    for actions, refused in (
        ({"low": [-2], "high": [2]}, "from -1 to 1"),
        ({"low": [-1, -1], "high": [1, 1]}, "1 output neurons"),
        ({"low": [-1], "high": [1]}, ""),
    ):
        (here / "codec.json").write_text(json.dumps({**coded, "actions": actions}))
        code, _, err = command(*words, "--episodes", "1", "--chip", "loihi1")
        assert refused in " ".join(err.split())
        assert code == (2 if refused else 0), err
    for chip in ("float", "loihi1"):
        controller = sd.load("mine.policy.nir").on(chip).controller()
        acted = {float(controller.act(np.array([x, x, 8 * x]))[0]) for x in np.linspace(-1, 1, 9)}
        assert (min(acted), max(acted)) == (-1, 1)
        assert len(acted) > 3
