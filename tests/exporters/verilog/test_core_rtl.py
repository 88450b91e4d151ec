"""The core's Verilog equals the emulator and the model, in Icarus and in Verilator."""

import subprocess
from dataclasses import replace

import nir
import numpy as np
import pytest

from spikedeploy import envs
from spikedeploy.envs.rollout import rollout
from spikedeploy.exporters.verilog.bench import BENCH, record
from spikedeploy.exporters.verilog.image import core_image
from spikedeploy.exporters.verilog.simulation import RtlProcess
from spikedeploy.exporters.verilog.to_verilog import CORE
from spikedeploy.runtime.artifact.artifact import Artifact
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.compiler.compile import compile_program
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.emulator.controllers import SpikingController
from spikedeploy.runtime.emulator.machine import Machine
from spikedeploy.seeds import VALIDATION
from spikedeploy.shipping.sources import world_of
from tests.c_builds import run
from tests.core_model import CoreModel
from tests.exporters.test_c_networks import delayed
from tests.exporters.verilog.test_core_model import ZOO, shipped
from tests.networks import cuba, ends, graph
from tests.rtl_builds import (
    EDGES,
    benched,
    build_simulation,
    cell_models,
    differing,
    edges,
    linted,
    needs_icarus,
    needs_verilator,
    needs_yosys,
    passes,
    recorded,
    written,
)

# parameters of the bench, where the core is for an UltraPlus
FREE_WIDTHS = (
    "int:weight_bits=5,decay_bits=7,accumulator=12-wrap,current=13-wrap,membrane=14-saturate"
)
ULTRA_PLUS = ("-Pbench.STATE_IN_SPRAM=1", "-Pbench.USE_DSP=1")


@needs_icarus
@pytest.mark.parametrize("seed", range(4))
def test_delays_loops_and_refractory_periods_equal_in_icarus(tmp_path, seed):
    reset = "subtract" if seed % 2 else "zero"
    program = delayed(seed)
    program = replace(program, convention=replace(program.convention, reset=reset))
    written(*recorded(program, timesteps=3, inferences=2, seed=seed), tmp_path)
    assert passes(benched(tmp_path, 7 * (seed % 2)))


@needs_icarus
@pytest.mark.parametrize(("name", "register"), EDGES)
def test_the_edges_of_each_register_equal_in_icarus(tmp_path, name, register):
    program, raster = edges(name, register, "subtract" if register.between else "zero")
    image = core_image(program)
    written(image, record(image, raster), tmp_path)
    assert passes(benched(tmp_path))


@needs_icarus
@pytest.mark.parametrize(
    ("name", "on"),
    [
        ("hexapod/sparse", "loihi1"),
        ("kart-steer/sparse-gated", "loihi1"),
        ("chips/CartPole-v1/loihi2", "loihi2"),
        ("chips/CartPole-v1/truenorth", FREE_WIDTHS),
    ],
)
def test_shipped_policies_equal_in_icarus_with_and_without_an_ultra_plus(tmp_path, name, on):
    artifact, program = shipped(name, on)
    found = recorded(program, min(artifact.codec.timesteps, 5), 3, rate=0.1, codec=artifact.codec)
    assert found[1].spikes.any()
    written(*found, tmp_path)
    assert passes(benched(tmp_path, 0, 3))
    assert passes(benched(tmp_path, 5, top=ULTRA_PLUS))


def foreign(seed):
    """A network that none of the trainers makes: two layers, a skip, a loop, a readout."""
    rng = np.random.default_rng(seed)

    def random(neurons, channels, bias=False):
        weight = rng.normal(0, 1, (neurons, channels)) * (rng.random((neurons, channels)) < 0.6)
        return nir.Affine(weight, rng.normal(0, 0.2, neurons)) if bias else nir.Linear(weight)

    nodes = {
        **ends(10, 3),
        "w1": random(12, 10, bias=True),
        "a": cuba(12, alpha=0.7),
        "w2": random(9, 12),
        "b": cuba(9, beta=0.95),
        "skip": random(9, 10),
        "loop": random(12, 9),
        "w3": random(3, 9),
        "out": nir.LI(*(np.full(3, v) for v in (4e-3, 4.0, 0.0))),
    }
    edges = "input->w1, w1->a, a->w2, w2->b, input->skip, skip->b, b->loop, loop->a, b->w3"
    return graph(f"{edges}, w3->out, out->output", **nodes)


@needs_icarus
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("on", ["int", "int:weight_bits=4,decay_bits=5,membrane=20-wrap", "loihi1"])
def test_networks_of_others_equal_in_icarus(tmp_path, seed, on):
    reset = "subtract" if on != "loihi1" and seed % 2 else "zero"
    clock = "pipelined" if seed != 1 or on == "loihi1" else "gated"
    convention = Convention(1e-3, state="kept", reset=reset, clock=clock)
    program = compile_program(Artifact(foreign(seed), None, convention), chip(on), clock=clock)
    image, found = recorded(program, timesteps=6, inferences=4, seed=seed)
    assert found.spikes.any()
    assert differing(image, found) == 0
    written(image, found, tmp_path)
    assert passes(benched(tmp_path, 0, 3))


@needs_icarus
def test_a_reset_in_any_clock_begins_anew(tmp_path):
    rng = np.random.default_rng(0)
    written(*recorded(shipped("kart-steer/sparse")[1], 1, 3, rate=0.1), tmp_path)
    for clock in rng.integers(3, 1500, 12).tolist():
        assert passes(benched(tmp_path, clock % 2 * 9, restart=clock))


@needs_icarus
def test_tokens_that_mean_nothing_are_ignored(tmp_path):
    image, found = recorded(delayed(3), timesteps=1)
    tokens = [[0x7FFF, 9, 0x8002, *each[:-1], 0xFFFF, each[-1]] for each in found.tokens]
    written(image, replace(found, tokens=tokens), tmp_path)
    assert passes(benched(tmp_path))


@needs_icarus
def test_the_bench_fails_where_a_number_differs(tmp_path):
    image, found = recorded(delayed(3), timesteps=1)
    found.membrane[-1, -1] += 1
    written(image, found, tmp_path)
    assert "FAIL: 1 numbers differ" in benched(tmp_path)[0]


@needs_icarus
@needs_yosys
@pytest.mark.fpga
@pytest.mark.parametrize(("dsp", "spram"), [(0, 0), (0, 1), (1, 1)])
def test_the_netlist_of_an_ice40_equals_in_icarus(tmp_path, dsp, spram):
    artifact, program = shipped("kart-steer/sparse")
    image, found = recorded(program, 1, 6, rate=0.05, codec=artifact.codec)
    written(image, found, tmp_path)
    netlist = f"read_verilog {CORE}; chparam -set USE_DSP {dsp} -set STATE_IN_SPRAM {spram}"
    netlist += f" policy_core; synth_ice40 -spram {'-dsp' * dsp} -top policy_core"
    models = cell_models("ice40")
    assert models is not None
    run("yosys", "-q", "-p", f"{netlist}; write_verilog -noattr netlist.v", folder=tmp_path)
    text = (tmp_path / "netlist.v").read_text()
    assert ("SB_SPRAM256KA " in text, "SB_MAC16 " in text) == (spram, dsp)
    options = ("-DNETLIST", "-DNO_ICE40_DEFAULT_ASSIGNMENTS", "-g2012")
    run("iverilog", *options, "-o", "bench", BENCH, "netlist.v", str(models), folder=tmp_path)
    for stall in (0, 5):
        assert "PASS" in run("vvp", "-N", "bench", f"+stall={stall}", folder=tmp_path)


@needs_verilator
@pytest.mark.parametrize("probe", [(), ("-DPOLICY_PROBE",)])
def test_verilator_has_no_warning(tmp_path, probe):
    programs = [delayed(0), delayed(5), edges(*EDGES[-1])[0], edges(*EDGES[12])[0]]
    programs += [shipped("hexapod/sparse")[1], shipped("kart-steer/snn")[1]]
    for program in programs:
        written(*recorded(program, 1, 1), tmp_path)
        assert linted(tmp_path, *probe) == ""
        assert linted(tmp_path, *probe, "-GUSE_DSP=1", "-GSTATE_IN_SPRAM=1") == ""


@needs_yosys
@pytest.mark.parametrize("seed", range(2))
def test_synthesis_finds_no_latch_and_no_net_with_two_drivers(tmp_path, seed):
    program = [delayed(1), shipped("hexapod/sparse")[1]][seed]
    written(*recorded(program, 1, 1), tmp_path)
    steps = f"read_verilog {CORE}; hierarchy -check -top policy_core; proc; flatten; opt_clean"
    steps += "; check -assert; select -assert-none t:$dlatch t:$adlatch t:$dlatchsr"
    command = ["yosys", "-q", "-p", steps]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@needs_verilator
def test_an_episode_equals_in_verilator_clock_for_clock(tmp_path):
    artifact, program = shipped("hexapod/sparse")
    image, found = recorded(program, 1, 300, rate=0.03, codec=artifact.codec)
    simulated = build_simulation(written(image, found, tmp_path))
    for stall in (None, 4):
        model = CoreModel(image)
        with RtlProcess(simulated, image, stall) as core:
            for k, tokens in enumerate(found.tokens):
                axons = [token for token in tokens if token < 0x8000]
                if tokens[0] == 0x8001:
                    core.reset()
                    model.reset()
                step = core.step(axons)
                for name in ("current", "membrane", "spikes"):
                    np.testing.assert_array_equal(getattr(step, name), getattr(found, name)[k])
                values = np.concatenate(list(step.values.values()))
                assert (values & 0xFFFFFFFF).tolist() == list(found.words[k])
                assert stall or step.clocks == model.step(axons).clocks


@needs_verilator
def test_the_bench_passes_in_verilator_too(tmp_path):
    written(*recorded(delayed(2), timesteps=3), tmp_path)
    command = ["verilator", "--binary", "-Wall", "-DPOLICY_PROBE", BENCH, CORE]
    command += ["-MAKEFLAGS", "OPT_GLOBAL=-O0 OPT_SLOW=-O0 OPT_FAST=-O0"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    for options in ([], ["+stall=9"]):
        said = subprocess.run(
            [tmp_path / "obj_dir" / "Vbench", *options],
            cwd=tmp_path,
            capture_output=True,
            text=True,
            check=True,
        )
        assert "PASS" in said.stdout


# sparse policies, and those with a rate code, of loihi1
SHIPPED = sorted(str(file.relative_to(ZOO).with_suffix("")) for file in ZOO.glob("[hk]*/s*.nir"))


@needs_verilator
@pytest.mark.fpga
@pytest.mark.parametrize("name", SHIPPED)
def test_twenty_episodes_of_a_shipped_policy_equal_in_verilator(tmp_path, name):
    artifact, program = shipped(name)
    image = core_image(program, artifact.codec)
    simulated = build_simulation(written(image, record(image, silence(image, artifact)), tmp_path))
    env = envs.make(world_of(name, artifact))
    kept = program.convention.state == "kept"
    wrong = 0
    for episode in range(20):
        controller = SpikingController(artifact, program.chip, "none")
        seen = rollout(env, controller, VALIDATION[0] + episode).observation[:-1]
        raster = artifact.codec.encode_episode(np.asarray(seen, np.float64))
        machine = Machine(program, 1, "none", trace=True)
        stall = episode if episode % 2 else None
        with RtlProcess(simulated, image, stall) as core:
            if episode % 3:  # an episode that is broken off
                core.step(range(0, image.axons, 3))
            core.reset()
            for inference in raster:
                if not kept:
                    core.reset()
                machine.infer(inference[None])
                wrong += unequal(core, machine, program, inference)
    env.close()
    assert wrong == 0


def silence(image, artifact):
    """Input spikes of one inference, none."""
    return np.zeros((1, artifact.codec.timesteps, image.axons), np.uint8)


def unequal(core, machine, program, inference):
    """Numbers of the core that are not those of the machine, which has run the inference."""
    found, seen = 0, machine.recordings
    steps = [core.step(np.flatnonzero(row).tolist()) for row in inference]
    for name in ("current", "membrane", "spikes"):
        wanted = np.concatenate([getattr(seen[a.name], name)[0] for a in program.layers], axis=1)
        found += np.count_nonzero(wanted != np.array([getattr(step, name) for step in steps]))
    for layer in program.output_layers:
        quantity = "spikes" if program.layer(layer).spiking else "membrane"
        wanted = getattr(seen[layer], quantity)[0]
        found += np.count_nonzero(wanted != np.array([step.values[layer] for step in steps]))
    return int(found)
