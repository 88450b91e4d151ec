"""C that tests build and run, with the compilers that there are."""

import ctypes
import shutil
import subprocess

import numpy as np
import pytest

from spikedeploy.exporters.c.packaging import write_texts
from spikedeploy.exporters.c.to_c import network_in_c, policy_in_c
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.compiler.compile import compile_program, own_clock

COMPILERS = tuple(name for name in ("gcc", "clang") if shutil.which(name))
# as the Makefile of an export has them, which another test builds with
STRICT = ("-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-ffp-contract=off")
SANITIZED = ("-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")
LOIHI = chip("loihi1")

needs_c = pytest.mark.skipif(not COMPILERS, reason="neither gcc nor clang is installed")


def run(*words, folder):
    """Run a command in a folder; AssertionError with what it wrote where it fails."""
    done = subprocess.run(words, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, (done.stdout + done.stderr)[-2000:]
    return done.stdout


def program_of(artifact, on=LOIHI):
    """The program of a policy as C of it computes."""
    return compile_program(artifact, on, clock=own_clock(artifact.convention))


def written(artifact, folder, observation, on=LOIHI, prefix="policy"):
    """The C of a policy, written; the files by name."""
    files = policy_in_c(program_of(artifact, on), artifact.codec, observation, "a test", prefix)
    write_texts(files.text, folder)
    return files


def built(folder, *flags, compiler=None, codec=True):
    """The self-test of an export, compiled."""
    sources = ["policy.c", *(["codec.c"] if codec else []), "selftest.c"]
    words = [compiler or COMPILERS[0], *STRICT, "-O1", *flags, "-DPOLICY_PROBE", "-o", "selftest"]
    run(*words, *sources, "-lm", folder=folder)
    return folder / "selftest"


def passed(program):
    """Numbers that a self-test compared; AssertionError where one differs."""
    return int(run(program, folder=program.parent).split()[0])


def library(folder, *sources, flags=()):
    """A shared object of sources of an export."""
    words = [COMPILERS[0], *STRICT, "-O1", *flags, "-fPIC", "-shared", "-o", "lib.so"]
    run(*words, *sources, "-lm", folder=folder)
    return ctypes.CDLL(str(folder / "lib.so"))


def called(function, given, found):
    """Call a C function on two arrays, of which it fills the second; its result."""
    return function(*(each.ctypes.data_as(ctypes.c_void_p) for each in (given, found)))


def check_network(program, folder, timesteps=4, inferences=3, rate=0.3, seed=0, flags=()):
    """The self-test of a program alone, driven by random spikes, passes."""
    rng = np.random.default_rng(seed)
    most = program.chip.input_spikes_max
    raster = (rng.random((inferences, timesteps, program.width)) < rate).astype(np.uint8)
    raster *= rng.integers(1, min(most, 3) + 1, raster.shape).astype(np.uint8)
    write_texts(network_in_c(program, raster, "a test").text, folder)
    assert passed(built(folder, *flags, codec=False)) > 0


def check_policy(artifact, observation, folder, on=LOIHI, flags=()):
    """The self-test of a policy passes."""
    written(artifact, folder, observation, on)
    assert passed(built(folder, *flags)) > 0
