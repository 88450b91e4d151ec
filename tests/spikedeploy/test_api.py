"""Three lines of Python: lazy, typed, and the same numbers as the commands."""

import importlib
import json
import re

import numpy as np
import pytest
import torch

import spikedeploy as sd
from spikedeploy.emulation.raster_emulation import emulate_artifact
from spikedeploy.envs.rollout import rollout
from spikedeploy.runtime.artifact.artifact import load as load_artifact
from spikedeploy.runtime.errors import (
    ArtifactError,
    ChipError,
    ConfigError,
    ObservationError,
    RuleError,
    SpikedeployError,
)
from spikedeploy.runtime.files import as_text
from spikedeploy.trainers.config import PopsanConfig
from tests import toy_stroll_env
from tests.paths import ROOT
from tests.project.test_import_rules import loaded_by

NET = ROOT / "examples/net.nir"
RASTER = ROOT / "examples/raster.npy"


@pytest.fixture
def out():
    return sd.load(NET, dt=1e-3).on("loihi1").run(np.load(RASTER))


def test_importing_the_package_loads_nothing():
    assert loaded_by("import spikedeploy", "numpy", "typer", "rich", "torch", "mujoco") == []


def test_running_a_network_needs_neither_torch_nor_physics_nor_pictures():
    run = f"sd.load({str(NET)!r}, dt=1e-3).on('loihi1').run({str(RASTER)!r})"
    code = f"import spikedeploy as sd; {run}"
    assert loaded_by(code, "torch", "mujoco", "pymunk", "matplotlib") == []


def test_every_public_name_exists_and_no_other():
    assert all(getattr(sd, name) for name in sd.__all__)
    assert set(sd.__all__) <= set(dir(sd))
    with pytest.raises(AttributeError, match="no attribute 'laod'"):
        _ = sd.laod


def test_a_run_is_what_emulate_gives(out):
    expected = emulate_artifact(load_artifact(NET, dt=1e-3), "loihi1", np.load(RASTER))
    assert out.spikes.keys() == expected.spikes.keys()
    for name, rows in expected.spikes.items():
        np.testing.assert_array_equal(out.spikes[name], rows)
    assert out.ledger.total("sop") == expected.ledger.total("sop") > 0
    assert out.energy == expected.as_json()["energy_j"]
    assert out.as_json() == expected.as_json()


def test_rasters_of_booleans_numbers_files_and_names_are_alike(out):
    net = sd.load(NET, dt=1e-3).on("loihi1")
    raster = np.load(RASTER)
    for other in (raster.astype(bool), raster.astype(float), RASTER, {"input": raster}):
        np.testing.assert_array_equal(net.run(other).spikes["hidden"], out.spikes["hidden"])


def test_masked_values_are_refused_and_other_numbers_are_named_by_their_range():
    net, raster = sd.load(NET, dt=1e-3).on("loihi1"), np.load(RASTER)
    with pytest.raises(ObservationError, match=r"masked values.* Fill them"):
        net.run(np.ma.MaskedArray(raster, mask=np.ones(raster.shape, bool)))
    with pytest.raises(ObservationError, match=r"^(?!.*float64).* from 0 to 300; a chip takes"):
        net.run(raster.astype(np.uint64) * 300)


def test_a_network_moves_between_chips_and_stays_as_it_was():
    net = sd.load(NET, dt=1e-3)
    assert (net.chip, net.on("loihi1").chip, net.chip) == ("float", "loihi1", "float")
    assert net.run(RASTER).chip == "float"
    assert net.on("loihi1").check().passed
    assert not net.check("loihi1", "xylo-a2").passed
    with pytest.raises(ChipError, match="did you mean"):
        net.on("loihi9")
    with pytest.raises(RuleError):
        net.on("xylo-a2").run(RASTER)


def test_spikes_are_plotted_without_a_display(out, tmp_path, monkeypatch):
    monkeypatch.delenv("DISPLAY", raising=False)
    figure = out.plot(tmp_path / "raster.png")
    assert [axes.get_ylabel() for axes in figure.axes] == list(out.spikes)
    assert (tmp_path / "raster.png").read_bytes().startswith(b"\x89PNG")


def test_a_comparison_is_that_of_the_command(stroll, command):
    found = sd.compare("stroll", ["stroll/popsan"], episodes=2)
    words = ("compare", "stroll", "stroll/popsan", "--episodes", 2, "--workers", 1, "--json")
    document = json.loads(command(*words)[1])
    assert json.loads(as_text(found.rows)) == document["rows"]
    assert found.meaning == document["meaning"]
    assert found.document["command"].startswith("spikedeploy compare stroll stroll/popsan")
    lines = str(found).splitlines()
    assert lines[0].split()[:2] == ["policy", "return"]
    assert found.meaning in lines
    assert "report.html" in [file.name for file in found.write("out")]


def test_a_loaded_policy_drives_and_is_compared_on_its_chip_and_as_its_file_says(stroll):
    net = sd.load("stroll/popsan").on("loihi2")
    rows = sd.compare("stroll", [net], episodes=1).rows
    (on_chip,) = [row for row in rows if row["chip"] == "loihi2"]
    walk = rollout(sd.make("stroll"), net.controller(), seed=10_000)
    assert walk.total == pytest.approx(on_chip["return_mean"])
    with pytest.raises(ArtifactError, match="no codec"):
        sd.compare("stroll", [sd.load(NET, dt=1e-3)])
    with pytest.raises(ArtifactError, match="loaded with other options than it states"):
        sd.compare("stroll", [sd.load("stroll/popsan", reset="subtract")], episodes=1)


def test_what_does_not_spike_is_refused(stroll):
    with pytest.raises(ConfigError, match="does not spike"):
        sd.load("stroll/sac")
    with pytest.raises(ConfigError, match="no network at 'nowhere'"):
        sd.load("nowhere")


def test_training_gives_a_run_folder(stroll):
    settings = ["steps=120", "validation.every=120", "env.name=stroll"]
    run = sd.train("smoke", overrides=settings, quiet=True)
    assert (run / "checkpoints/last.safetensors").is_file()


def test_the_example_of_a_policy_of_ones_own_races(tmp_path):
    code = (ROOT / "examples/own_policy.py").read_text(encoding="utf-8")
    example = {"__name__": "own_policy"}
    exec(compile(code, "own_policy.py", "exec"), example)
    found = example["main"](tmp_path / "own.nir", rounds=1, steps=40, episodes=1)
    chips = [row["chip"] for row in found.rows if row["policy"] == "own"]
    assert chips == ["float", "loihi1"]


def test_the_example_of_an_environment_of_ones_own_is_trained_and_compared(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(ROOT / "examples")
    monkeypatch.chdir(tmp_path)
    own_env = importlib.import_module("own_env")
    small = ("steps=128", "env.count=2", "horizon=16", "epochs=1", "minibatch=16")
    less = ("critic_hidden=[8]", "policy.hidden=[8,8]", "policy.timesteps=2", "validation.every=64")
    found = own_env.main(*small, *less, "validation.episodes=1", episodes=1)
    assert [row["chip"] for row in found.rows] == ["float", "loihi1", None]
    assert {row["success_rate"] for row in found.rows} <= {0.0, 1.0}
    assert "random" in str(found)


def test_a_file_is_read_as_its_author_meant_it_and_checked_so():
    file = ROOT / "tests/golden/exports/snntorch_leaky.nir"
    net = sd.load(file, written_by="snntorch")
    assert net.artifact.convention.reset == "subtract-delayed"
    assert not net.check("loihi1").passed  # its reset is none of Loihi's
    assert sd.load(file, written_by="snntorch", reset="zero").check("loihi1").passed


def test_the_last_run_is_compared_by_its_name(stroll):
    toy_stroll_env.run_folder(stroll / "runs", PopsanConfig(hidden=(6,), populations=3))
    rows = sd.compare("stroll", ["last"], episodes=1).rows
    assert "loihi1" in {row["chip"] for row in rows}


SCRIPT = """
import numpy as np
import spikedeploy as sd

net = sd.load("net.nir", dt=1e-3, written_by=None).on("loihi1", limits="off")
out = net.run(np.zeros((10, 16), np.uint8))
spikes: int = int(out.spikes["hidden"].sum())
joules: float = out.energy["davies2018"]
total: int = out.ledger.total("sop") if out.ledger is not None else 0
rows: list[dict[str, object]] = list(sd.compare("hexapod", [net], chips=["loihi1"]).rows)
run: str = str(sd.train("hexapod-sac", seed=1))
steps: object = sd.make("CartPole-v1").reset(seed=0)
version: str = sd.__version__
"""


def test_a_users_script_is_typed(tmp_path, monkeypatch):
    api = pytest.importorskip("mypy.api")
    monkeypatch.chdir(ROOT)
    script = tmp_path / "script.py"
    script.write_text(SCRIPT + "net.rum(1)\nsd.load('net.nir', dt='a')\n", encoding="utf-8")
    said, wrong, _ = api.run(["--config-file=pyproject.toml", "--hide-error-context", str(script)])
    errors = [line for line in said.splitlines() if "error:" in line]
    assert wrong == ""
    assert len(errors) == 2, said
    assert 'has no attribute "rum"' in errors[0]
    assert 'Argument "dt" to "load" has incompatible type "str"' in errors[1]


@pytest.mark.parametrize("chip", ["float", "loihi1"])
def test_a_batch_runs_as_its_inferences_do_and_its_repr_is_short(chip):
    net = sd.load(NET, dt=1e-3).on(chip)
    raster = np.load(RASTER)
    other = raster[::-1]
    batch, singles = net.run(np.stack([raster, other])), [net.run(raster), net.run(other)]
    for name, rows in batch.spikes.items():
        np.testing.assert_array_equal(rows, np.stack([each.spikes[name] for each in singles]))
    assert batch.ledger.total("sop") == sum(each.ledger.total("sop") for each in singles) > 0
    assert batch.timesteps == singles[0].timesteps == 200
    for each in (batch, *singles):
        assert len(repr(each)) < 500
        assert "synaptic operations" in repr(each)
    with pytest.raises(ObservationError, match=r"takes \(B, T, 16\)"):
        net.run(raster[0])


def test_a_run_whose_events_cannot_be_counted_says_why():
    out = sd.load(NET, dt=1e-3).run(np.full((20, 16), 0.5))
    assert out.ledger is None
    assert "events cannot be counted" in out.uncounted
    assert "not counted" in repr(out)


MINE = ROOT / "tests/golden/exports/snntorch_leaky.nir"


@pytest.mark.parametrize(
    ("ask", "said"),
    [
        (lambda net: sd.load(net.artifact.graph), "found a NIRGraph. Write a graph with nir.write"),
        (lambda net: sd.load(MINE, dt="1ms"), "dt must be a finite number of seconds"),
        (lambda net: sd.load(MINE, dt="1ms", written_by="snntorch"), "above 0, found '1ms'"),
        (lambda net: ran(net).ledger.total("sops"), "event 'sops' is unknown. Choose one of spike"),
        (lambda net: ran(net).ledger.per_inference("foo"), "event 'foo' is unknown"),
        (lambda net: ran(net).ledger.by_layer("foo"), "event 'foo' is unknown"),
        (lambda net: net.run(torch.ones(3, 12, requires_grad=True)), "Give raster.detach()"),
    ],
)
def test_a_slip_in_python_is_a_sentence(ask, said):
    net = sd.load(MINE, written_by="snntorch", reset="zero").on("loihi1")
    with pytest.raises(SpikedeployError, match=re.escape(said)):
        ask(net)


def ran(net):
    return net.run(np.ones((3, 12), np.uint8))


def test_a_report_prints_its_verdicts():
    said = str(sd.load(MINE, written_by="snntorch").check("loihi1", "ideal"))
    assert "✗ loihi1\n  rule reset: node " in said
