"""`export --to program`: integers, input and expectations as plain files, and scripts."""

import ast
import hashlib
import importlib.util
import json
import os
import subprocess
import sys
from dataclasses import replace
from functools import cache
from shutil import copytree

import numpy as np
import pytest

from lab.peers import kits
from spikedeploy.exporters import to_program
from spikedeploy.exporters.to_program import TOOLS, chip_run
from spikedeploy.runtime.artifact.artifact import load, save
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.codec.codec import Codec, DeltaEncoder, Normaliser, PopulationEncoder
from spikedeploy.runtime.codec.rate import RateEncoder
from spikedeploy.runtime.compiler.compile import compile_program
from spikedeploy.runtime.emulator.controllers import SpikingController
from spikedeploy.runtime.emulator.interpreter import Interpreter
from spikedeploy.runtime.emulator.machine import Machine
from spikedeploy.runtime.traces import verdict
from spikedeploy.runtime.traces.fields import read_json
from spikedeploy.runtime.traces.programs import program_in
from spikedeploy.runtime.traces.verify import verify
from spikedeploy.shipping.export_program import export_program
from tests.networks import popsan
from tests.paths import ROOT
from tests.waiting import PATIENCE

SCRIPTS = ROOT / "exporters" / "kit"
LIBRARIES = {
    "host_codec.py": {"numpy"},
    "host.py": {"numpy", "gymnasium", "spikedeploy"},  # these two for --loop ENV alone
    "run_lava.py": {"numpy", "lava"},
    "run_nengo_loihi.py": {"numpy", "nengo_loihi"},
    "run_xylo.py": {"numpy", "xylosim", "rockpool"},
    "run_sinabs.py": {"numpy", "sinabs", "torch"},
    "run_spinnaker2.py": {"numpy", "spinnaker2"},
}
CLOCKS = {"loihi1": "pipelined", "loihi1-nengo": "pipelined"}
RESETTING = [f"chips/{env}/{on}" for env, on in (
    ("CartPole-v1", "xylo-a2"), ("CartPole-v1", "speck2f"), ("CartPole-v1", "loihi2"),
    ("CartPole-v1", "spinnaker2"), ("Pendulum-v1", "speck2f"),
)]  # fmt: skip
NETWORKS = {
    "loihi1": "hexapod/sparse",
    "loihi1-nengo": "kart-steer/sparse",
    "loihi2": "examples/net.nir",
    "xylo-a2": kits.xylo_policy,
    "speck2f": kits.speck_policy,
    "spinnaker2": "examples/net.nir",
}


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """Kit and network file of a chip, written once."""

    @cache
    def made(chip_name, steps):
        folder = tmp_path_factory.mktemp("kit")
        network, env, raster = NETWORKS.get(chip_name, chip_name), None, None
        chip_name = chip_name.rpartition("/")[2]
        if callable(network):
            file, env = folder / "net.nir", "CartPole-v1"
            save(network(), file)
        elif network.startswith("examples"):
            file, raster = ROOT / network, ROOT / "examples" / "raster.npy"
        else:
            file = ROOT / "spikedeploy" / "zoo" / f"{network}.nir"
        clock = CLOCKS.get(chip_name)
        kit = export_program(
            str(file), folder / "kit", chip=chip_name, observations=steps, raster=raster,
            env=env, clock=clock,
        )  # fmt: skip
        return kit, file

    return made


@pytest.fixture
def kit_of(written, tmp_path):
    """A copy of the kit of a chip, and the network's file."""

    def copied(chip_name, steps=12):
        kit, file = written(chip_name, steps)
        return replace(kit, path=copytree(kit.path, tmp_path / "kit")), file

    return copied


def read_back(folder):
    return program_in(read_json(folder / "program.json"), timesteps=1)


@pytest.mark.parametrize("name", NETWORKS)
def test_the_files_hold_exactly_the_integers_of_the_program(name, kit_of):
    kit, file = kit_of(name)
    options = {"delay": 1} if name == "loihi1-nengo" else {}
    on = chip(name, **options)
    clock = CLOCKS.get(name, "gated" if name == "speck2f" else "free")
    compiled = compile_program(load(file), on, clock=clock)
    program = chip_run(compiled, 1).program
    found = read_back(kit.path)
    ends = ("input", "width", "output")
    assert [getattr(found, end) for end in ends] == [getattr(program, end) for end in ends]
    assert [layer.name for layer in found.layers] == [layer.name for layer in program.layers]
    for ours, theirs in zip(program.layers, found.layers, strict=True):
        for field in ("threshold", "voltage_bias", "current_decay", "membrane_decay"):
            np.testing.assert_array_equal(getattr(ours, field), getattr(theirs, field), field)
        assert ours.spiking == theirs.spiking
        for one, other in zip(ours.synapses, theirs.synapses, strict=True):
            np.testing.assert_array_equal(one.weight, other.weight)
            assert (one.source, one.delay, one.shift, one.current) == (
                other.source, other.delay, other.shift, other.current,
            )  # fmt: skip
    assert verify(kit.path / "expected.json").equal


def _without_program(folder):
    (folder / "program.json").unlink()
    return "its program program.json cannot be read"


def _other_program(folder):
    path = folder / "program.json"
    path.write_text(path.read_text().replace('"decay_v"', '"decay_v" ', 1))
    return "was recorded of another"


def _damaged(change, message):
    """Damage of the program, whose digest the trace then has."""

    def damage(folder):
        record = json.loads((folder / "program.json").read_text())
        change(record)
        text = json.dumps(record)
        (folder / "program.json").write_text(text)
        digest = hashlib.sha256(text.encode()).hexdigest()
        _edit(folder, program_sha256=digest)
        return message

    return damage


def _edit(folder, **fields):
    path = folder / "expected.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), **fields}))


def _edited(message, **fields):
    def damage(folder):
        _edit(folder, **fields)
        return message

    return damage


def _layer(record, **fields):
    record["layers"][0].update(fields)


DAMAGE = {
    "no program": _without_program,
    "another program": _other_program,
    "chip": _damaged(lambda r: r.update(chip="loihi9"), "chip is 'loihi9'"),
    "output": _damaged(lambda r: r.update(output="x"), "output is 'x'. Name one of the layers"),
    "dt": _damaged(lambda r: r.update(dt=-1), "make no program (dt must be"),
    "decay": _damaged(lambda r: _layer(r, decay_v=[5000] * 8), "decay_v holds 5000"),
    "size": _damaged(lambda r: _layer(r, vth=[1, 2]), "vth has 2 values"),
    "weights": _damaged(
        lambda r: r["layers"][0]["synapses"][0].update(weights=[[1]]), "weights has shape (1, 1)"
    ),
    "source": _damaged(lambda r: r["layers"][0]["synapses"][0].update(source="?"), "source is '?'"),
    "delay": _damaged(lambda r: r["layers"][1]["synapses"][0].update(delay=-1), "delay holds -1"),
    "no such file": _edited("program is '../x.json'", program="../x.json"),
    "events": _edited("input_events leave the raster", input_events=[[0, 462]]),
    "twice": _edited("input_events repeat one 2 times", input_events=[[0, 1], [0, 1]]),
    "rows": _edited("membrane has shape (1, 1)", recorded={"lif1": {"membrane": [[0]]}}),
    "nothing": _edited("there is nothing to compare", recorded={}),
    "quantity": _edited("is of no known quantity, 'x'", recorded={"lif1": {"x": [[0]]}}),
    "long": _edited("timesteps holds", timesteps=1 << 30),
}


@pytest.mark.parametrize("name", DAMAGE)
def test_a_damaged_folder_is_one_sentence(name, command, kit_of):
    kit, _ = kit_of("loihi1")
    message = DAMAGE[name](kit.path)
    code, out, err = command("verify", str(kit.path / "expected.json"))
    assert (code, message in out + err) == (2, True), out + err
    assert "Traceback" not in out + err


@pytest.mark.parametrize(
    ("policy", "clock"), [("hexapod/sparse", "pipelined"), ("hexapod/sparse-gated", "free")]
)
def test_what_is_expected_is_what_our_controller_does_in_its_clock(policy, clock, tmp_path):
    kit = export_program(policy, tmp_path / "kit", chip="loihi1", observations=15)
    record = json.loads((kit.path / "program.json").read_text())
    per_step = {"pipelined": 1, "free": 3}[clock]
    assert (record["clock"], record["control_step"]["timesteps"]) == (clock, per_step)
    artifact = load(ROOT / f"spikedeploy/zoo/{policy}.nir")
    controller = SpikingController(artifact, chip("loihi1"), "none", clock=clock)
    with np.load(kit.path / "episode.npz") as episode:
        for observation, action in zip(episode["observation"], episode["action"], strict=False):
            np.testing.assert_array_equal(controller.act(observation), action)
    assert kit.facts["timesteps"] == 15 * per_step


@pytest.mark.parametrize("name", RESETTING)
def test_of_a_policy_that_resets_each_inference_from_zero_states_is_expected(name, kit_of):
    kit, file = kit_of(name)
    artifact, on = load(file), chip(name.rpartition("/")[2])
    step = json.loads((kit.path / "program.json").read_text())["control_step"]
    timesteps = artifact.codec.timesteps
    program = compile_program(artifact, on, clock="gated" if on.name == "speck2f" else "free")
    assert (step["state"], step["timesteps"]) == ("reset", program.rows(timesteps))
    expected = json.loads((kit.path / "expected.json").read_text())["recorded"]
    controller = SpikingController(artifact, on, "none", clock=program.clock, trace=True)
    with np.load(kit.path / "episode.npz") as episode:
        for k, observation in enumerate(episode["observation"][:12]):
            np.testing.assert_array_equal(controller.act(observation), episode["action"][k])
            for layer in program.layers:
                rows = np.array(expected[layer.name]["spikes"]).reshape(12, step["timesteps"], -1)
                found = rows[k, program.window(layer, step["timesteps"])]
                recorded = controller.network.recordings[layer.name]
                np.testing.assert_array_equal(found, recorded.spikes[0])
    assert all(np.any(each["spikes"]) for each in expected.values())
    assert verify(kit.path / "expected.json").equal


def run_host(kit, monkeypatch, own=None, *words):
    """What the kit's host.py returns with a chip of ours."""
    monkeypatch.setattr(sys, "argv", ["run", *words])
    return host_in(kit.path).main(lambda *_: own or OwnChip(kit.path), "ours")


def test_a_run_of_some_control_steps_is_verified_and_one_that_ends_within_is_refused(
    kit_of, monkeypatch, command
):
    kit, _ = kit_of(RESETTING[0])
    assert run_host(kit, monkeypatch, None, "--steps", "3") == 0
    assert verify(kit.path / "ours.json").steps == 27
    trace = json.loads((kit.path / "ours.json").read_text())
    (kit.path / "ours.json").write_text(json.dumps({**trace, "timesteps": 26}))
    code, out, err = command("verify", str(kit.path / "ours.json"))
    assert (code, "States are reset every 9 timesteps" in out + err) == (2, True), out + err


def script_of(kit, *words, without=()):
    """What the kit's script says where some packages are missing."""
    text = "import runpy, sys; sys.path.insert(0, '.'); " + "".join(
        f"sys.modules[{name!r}] = None; " for name in without
    )
    text += f"runpy.run_path({kit.files[5]!r}, run_name='__main__')"
    return subprocess.run(
        [sys.executable, "-c", text, *words],
        cwd=kit.path, capture_output=True, text=True, check=False, timeout=PATIENCE,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("env", "without", "message"),
    [
        ("mine:Env", "mine", "install that module, or put it beside host.py"),
        ("CartPole-v1", "gymnasium", "install gymnasium"),
        ("CartPole-v99", "", "--loop CartPole-v99: "),
        ("spikedeploy:hexapod", "spikedeploy.envs", "`pip install .` in a checkout"),
    ],
)
def test_a_loop_without_its_environment_says_what_to_install(
    env, without, message, kit_of, monkeypatch
):
    kit, _ = kit_of(RESETTING[0])
    if without:
        monkeypatch.setitem(sys.modules, without, None)
    with pytest.raises(SystemExit) as ended:
        run_host(kit, monkeypatch, None, "--loop", env)
    assert message in str(ended.value)


@pytest.mark.parametrize("on", ["xylo-a3", "xylo-imu"])
def test_a_dev_kit_whose_states_rockpool_cannot_zero_is_refused_by_name(on, tmp_path):
    kit = export_program(RESETTING[0], tmp_path / "kit", chip=on, observations=2)
    done = script_of(kit)
    assert (done.returncode, f"cannot zero the states of {on}" in done.stderr) == (1, True)


@pytest.mark.parametrize(
    ("words", "message"),
    [((), "names no environment"), (("--env", "CartPole-v1"), "Give fewer --observations")],
)
def test_a_kit_without_an_episode_or_with_one_too_long_to_be_verified_is_not_written(
    words, message, command, here, monkeypatch
):
    save(kits.speck_policy(), here / "net.nir")
    monkeypatch.setattr(verdict, "MOST_WORK", 100)
    export = ("export", str(here / "net.nir"), "--to", "program", "--chip", "speck2f", "-o", "kit")
    code, _, err = command(*export, *words)
    assert (code != 0, message in err, (here / "kit").exists()) == (True, True, False), err


def test_a_bias_is_an_axon_that_spikes_in_the_window_of_its_layer(tmp_path):
    artifact = popsan()  # biases are weights of an axon; one window from reset
    rows = (np.random.default_rng(0).random((5, 30)) < 0.3).astype(np.uint8)
    save(artifact, tmp_path / "net.nir")
    np.save(tmp_path / "rows.npy", rows)
    file, raster = str(tmp_path / "net.nir"), tmp_path / "rows.npy"
    kit = export_program(file, tmp_path / "kit", chip="loihi1", observations=5, raster=raster)
    step = json.loads((kit.path / "program.json").read_text())["control_step"]
    assert (step["timesteps"], step["inject"]) == (8, [0, 5])
    assert step["bias_axons"] == [[0, 5], [1, 6], [2, 7]]
    machine = Machine(compile_program(artifact, chip("loihi1")), 1, trace=True)
    machine.infer(rows[None])
    expected = json.loads((kit.path / "expected.json").read_text())["recorded"]
    for late, name in enumerate(expected, start=1):
        window = np.array(expected[name]["spikes"])[late : late + 5]
        np.testing.assert_array_equal(window, machine.recordings[name].spikes[0])
    assert any(np.any(each["spikes"]) for each in expected.values())


def _cut(name):
    def cut(folder):
        (folder / name).write_bytes((folder / name).read_bytes()[:300])
        return f"{name} cannot be read"

    return cut


def _tables(change):
    """Tables of expected.json that are changed, row by row."""

    def damage(folder):
        layers = json.loads((folder / "expected.json").read_text())["recorded"]
        _edit(folder, recorded={k: {q: change(t) for q, t in v.items()} for k, v in layers.items()})
        return "does not fit program.json"

    return damage


HOST_DAMAGE = {
    "cut program": _cut("program.json"),
    "cut expectation": _cut("expected.json"),
    "another program": _edited("is of another program.json", program_sha256="0" * 64),
    "no layers": _edited("does not fit", recorded={}),
    "one row": _tables(lambda table: table[:1]),
    "one neuron": _tables(lambda table: [row[:1] for row in table]),
    "events before the first": _edited("does not fit", input_events=[[-1, 0]]),
    "events beyond the last": _edited("does not fit", input_events=[[0, 10**6]]),
    "events of another kind": _edited("does not fit", input_events=[["x", {}]]),
    "hours": _edited("does not fit", timesteps=10**12),
    "--loop": _cut("episode.npz"),
    "--loop CartPole-v1": lambda _: "observes other numbers than the policy",
    "--steps -3": lambda _: "2",
}


@pytest.mark.parametrize("name", HOST_DAMAGE)
def test_a_script_of_a_damaged_kit_ends_with_one_sentence(name, kit_of, monkeypatch):
    kit, _ = kit_of("loihi1")
    message = HOST_DAMAGE[name](kit.path)
    with pytest.raises(SystemExit, match=message):
        run_host(kit, monkeypatch, None, *(name.split() if name[0] == "-" else ()))
    assert not (kit.path / "ours.json").exists() or name.startswith("--loop")


def test_files_of_others_are_not_replaced_and_a_failed_export_leaves_the_last_whole(
    command, here, monkeypatch
):
    words = ("export", "hexapod/sparse", "--to", "program", "-o", "kit", "--observations", "3")
    (here / "kit").mkdir()
    (here / "kit" / "README.md").write_text("mine")
    assert command(*words)[0] == 2
    assert (here / "kit" / "README.md").read_text() == "mine"
    assert command(*words, "--force")[0] == 0
    before = {path.name: path.read_bytes() for path in (here / "kit").iterdir()}

    def breaks(*_):
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as full:
        full.setattr(os, "replace", breaks)
        assert command(*words[:-1], "5")[0] != 0
    assert {path.name: path.read_bytes() for path in (here / "kit").iterdir()} == before
    assert command(*words)[0] == 0


@pytest.mark.parametrize("name", LIBRARIES)
def test_a_script_imports_numpy_and_its_tool_alone(name):
    text = (SCRIPTS / name).read_text("utf-8")
    found = set()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import):
            found |= {alias.name.partition(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            found.add(node.module.partition(".")[0])
    assert found - set(sys.stdlib_module_names) - {"host", "host_codec"} <= LIBRARIES[name]
    assert {tool.script for tool in TOOLS.values()} | {"host.py", "host_codec.py"} == set(LIBRARIES)


@pytest.mark.parametrize("name", NETWORKS)
def test_the_readme_of_a_kit_says_all_that_is_needed_to_run_it(name, kit_of):
    kit, _ = kit_of(name)
    tool = next(each for each in TOOLS.values() if each.name == kit.facts["tool"])
    readme = (kit.path / "README.md").read_text()
    step = json.loads((kit.path / "program.json").read_text())["control_step"]
    rows = f"{step['inject'][1]} rows of input take {step['timesteps']} timesteps"
    said = f"writes what it did as `{tool.name}.json`"
    texts = (rows, tool.install, tool.board, said)
    assert [text for text in (*texts, "`pip install .` in a checkout") if text not in readme] == []
    assert "$" not in readme.replace("```sh", "")
    script = (kit.path / tool.script).read_text()
    assert script == (SCRIPTS / tool.script).read_text()
    assert f'"{tool.name}"' in script.splitlines()[-1] + script.splitlines()[-2]
    assert tool.script in tool.board


def host_in(folder):
    """The kit's own host.py, imported from its folder."""
    sys.path.insert(0, str(folder))
    try:
        spec = importlib.util.spec_from_file_location("kit_host", folder / "host.py")
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
    finally:
        sys.path.remove(str(folder))
        sys.modules.pop("host_codec", None)
    return module


ENCODERS = {
    "delta": DeltaEncoder(np.array([0.1, 0.5, np.inf])),
    "delta one-hot": DeltaEncoder(np.array([0.1, 0.5, 2.0]), 4, "one-hot", 200),
    "population": PopulationEncoder(np.linspace(-2, 2, 12).reshape(3, 4), np.full((3, 4), 0.4)),
    "rate": RateEncoder(np.full(3, -1.0), np.full(3, 1.5)),
}


@pytest.mark.parametrize("name", ENCODERS)
def test_the_hosts_encoder_sends_the_spikes_of_ours(name, kit_of):
    rng = np.random.default_rng(0)
    normaliser = Normaliser(rng.normal(size=3), rng.uniform(0.5, 2, 3), 2.5)
    codec = Codec(normaliser, ENCODERS[name], 5, "tanh")
    kit, _ = kit_of("speck2f", steps=2)
    record = json.loads((kit.path / "program.json").read_text())
    record["host"] = {"codec": to_program.plain_record(codec.to_record())}
    record["host"] |= {"bias": [0.0], "terms": [], "plain": False}
    record["input"]["width"] = codec.encoder.width
    record["control_step"] = {"timesteps": 7, "bias_axons": []}
    host = host_in(kit.path).Codec(record)
    state = codec.encoder.start(0)
    seen = np.cumsum(rng.normal(0, 0.4, (40, 3)), axis=0)
    for observation in seen:
        ours = codec.encode(observation[None], state)[0]
        np.testing.assert_array_equal(host.encode(observation)[:5], ours)


class OwnChip:
    """The kit's program on our interpreter, as a script's chip."""

    def __init__(self, folder):
        self.program = read_back(folder)
        self.reset()

    def reset(self):
        self.run_on = Interpreter(self.program, 1)

    def run(self, rows):
        traces = self.run_on.run(rows[None].astype(np.uint8))
        return {
            name: {"membrane": found.membrane[0], "spikes": found.spikes[0]}
            for name, found in traces.items()
        }

    def stop(self):
        pass


@pytest.mark.parametrize(
    ("name", "env"),
    [
        ("loihi1", "spikedeploy:hexapod"),
        ("speck2f", "CartPole-v1"),
        ("chips/CartPole-v1/xylo-a2", "CartPole-v1"),
        ("chips/Pendulum-v1/speck2f", "Pendulum-v1"),  # torques of -2 to 2
    ],
)
@pytest.mark.parametrize("loop", ["recorded", "env"])
def test_the_hosts_loop_gives_the_actions_and_the_return_that_are_expected(
    name, env, loop, kit_of, monkeypatch, capsys
):
    kit, _ = kit_of(name)
    code = run_host(kit, monkeypatch, None, "--loop", *([env] if loop == "env" else []))
    out = capsys.readouterr().out
    assert (code, "at most 0 from expected" in out) == (0, True), out
    with np.load(kit.path / "loop_ours.npz") as file, np.load(kit.path / "episode.npz") as seen:
        np.testing.assert_array_equal(file["action"], seen["action"])
        if loop == "env":
            np.testing.assert_array_equal(file["reward"], seen["reward"])


def test_a_chip_that_does_something_else_is_found_by_the_host_and_by_verify(
    kit_of, monkeypatch, capsys, command
):
    kit, _ = kit_of("loihi1")

    class Wrong(OwnChip):
        def run(self, rows):
            found = super().run(rows)
            found["readout"]["membrane"][7, 1] -= 1
            return found

    assert run_host(kit, monkeypatch, Wrong(kit.path)) == 1
    assert "differs: timestep 7, readout, neuron 1, membrane" in capsys.readouterr().out
    trace = json.loads((kit.path / "ours.json").read_text())
    del trace["recorded"]["lif1"]  # what a tool cannot measure is left out
    (kit.path / "ours.json").write_text(json.dumps(trace))
    code, out, _ = command("verify", str(kit.path / "ours.json"))
    assert (code, "step 7, readout, neuron 1, membrane: expected" in out) == (1, True)


def test_nengo_loihis_emulator_runs_the_kit_and_closes_the_loop(kit_of):
    pytest.importorskip("nengo_loihi")
    kit, _ = kit_of("loihi1-nengo", steps=30)
    for words in ((), ("--loop",)):
        done = subprocess.run(
            [sys.executable, "-W", "ignore", "run_nengo_loihi.py", *words],
            cwd=kit.path, capture_output=True, text=True, check=False, timeout=PATIENCE,
        )  # fmt: skip
        assert done.returncode == 0, done.stdout + done.stderr
    assert verify(kit.path / "nengo-loihi.json").equal
