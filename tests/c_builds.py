"""C that tests build and run, with the compilers that there are."""

import shutil
import subprocess

import numpy as np
import pytest

from spikedeploy.exporters.c.to_c import network_in_c, policy_in_c, write

COMPILERS = tuple(name for name in ("gcc", "clang") if shutil.which(name))
# as the Makefile of an export has them, which another test builds with
STRICT = ("-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-ffp-contract=off")
SANITIZED = ("-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")

needs_c = pytest.mark.skipif(not COMPILERS, reason="neither gcc nor clang is installed")


def built(folder, *flags, compiler=None, output="selftest", codec=True):
    """The self-test of an export, compiled."""
    sources = ["policy.c", *(["codec.c"] if codec else []), "selftest.c"]
    compiler = compiler or COMPILERS[0]
    words = [compiler, *STRICT, "-O1", *flags, "-DPOLICY_PROBE", "-o", output, *sources, "-lm"]
    done = subprocess.run(words, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return folder / output


def passed(program):
    """Numbers that a self-test compared; AssertionError where one differs."""
    done = subprocess.run([program], capture_output=True, text=True, check=False)
    assert done.returncode == 0, (done.stdout + done.stderr)[-2000:]
    return int(done.stdout.split()[0])


def check_network(program, folder, timesteps=4, inferences=3, rate=0.3, seed=0, flags=()):
    """The self-test of a program alone, driven by random spikes, passes."""
    rng = np.random.default_rng(seed)
    most = program.chip.input_spikes_max
    raster = (rng.random((inferences, timesteps, program.width)) < rate).astype(np.uint8)
    raster *= rng.integers(1, min(most, 3) + 1, raster.shape).astype(np.uint8)
    write(network_in_c(program, raster, "a test"), folder)
    return passed(built(folder, *flags, codec=False))


def check_policy(program, codec, observation, folder, flags=()):
    """The self-test of a policy passes."""
    write(policy_in_c(program, codec, observation, "a test"), folder)
    return passed(built(folder, *flags))
