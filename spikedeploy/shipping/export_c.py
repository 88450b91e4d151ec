"""A policy as C99, of a chip if it spikes, else with 8-bit weights; what it takes or changes."""

import os
from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path
from shlex import quote

import numpy as np

from spikedeploy.console import say
from spikedeploy.exporters.c.int8 import quantise as quantise_network
from spikedeploy.exporters.c.int8 import read_onnx
from spikedeploy.exporters.c.int16 import action_as_floats
from spikedeploy.exporters.c.packaging import MAKEFILE, MARK, RECORD, file_names, write_texts
from spikedeploy.exporters.c.refusals import check_prefix
from spikedeploy.exporters.c.to_c import mlp_in_c, policy_in_c
from spikedeploy.exporters.check import ExportResult
from spikedeploy.outputs import check_output_folder, has_text
from spikedeploy.policies.onnx import OnnxController
from spikedeploy.runtime.chips.chip import chip as chip_named
from spikedeploy.runtime.chips.quantisation import PLAIN, Granularity
from spikedeploy.runtime.compiler.compile import clock_on, compile_program, own_clock
from spikedeploy.runtime.convention import CLOCKS
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.files import suffix
from spikedeploy.shipping.sources import (
    Observations,
    SpikingSource,
    is_ours,
    observations_of,
    origin_of,
    policy_file,
    require_output,
)

_INT8_STEPS = 200  # of the self-test of a float policy


def export_c(
    policy: str,
    path: Path | None,
    *,
    chip: str | None = None,
    quantise: Granularity = PLAIN.granularity,
    observations: int = 1000,
    env: str | None = None,
    prefix: str = "policy",
    force: bool = False,
) -> ExportResult:
    """Write a policy as C: a spiking one of a chip, a float one with 8-bit weights.

    path: path of the folder.
    chip: None is that of its training, or the default; refused of a float policy.
    quantise: whether neurons have scales of their own.
    observations: observations of an episode, from which the self-test and the typical operations
        come, or on which actions are compared.
    env: in which the episode is played; None is what the policy names, of ours.
    prefix: what names in C begin with.
    force: whether files that no earlier export wrote are replaced.
    """
    folder, file = require_output(path, "a folder", "firmware"), policy_file(policy)
    check_prefix(prefix)
    if suffix(file) == ".onnx" and file.is_file():
        if chip is not None or quantise != PLAIN.granularity:
            raise ConfigError(
                f"--to c: {policy} is a float network, whose C is of no chip and has a scale for "
                "each input; leave --chip and --quantise out."
            )
        names = file_names(prefix, spiking=False)
        check_output_folder("-o", folder, names, (file, policy), force, is_export)
        return _export_float(file, folder, observations, prefix, env)
    source = SpikingSource.read(policy, "c", chip, quantise)
    codec, on = source.require_codec(), chip_named(source.chip)
    check_output_folder("-o", folder, file_names(prefix), (source.file, policy), force, is_export)
    # software updates a layer when it is told to, whatever the chip can; its options come first
    clock = on.clock or own_clock(source.artifact.convention)
    software = replace(on, clocks=CLOCKS)
    program = compile_program(source.artifact, software, source.quantisation, clock)
    # the episode is the chip's, which may advance its layers by another clock than software
    played = program
    if clock not in on.clocks:
        own = on.clock or clock_on(source.artifact.convention, on)
        played = replace(program, chip=on, clock=own)
        if "pipelined" in (clock, own):  # whose layers start at other timesteps
            played = compile_program(source.artifact, on, source.quantisation)
    seen, recorded = source.episode(played, observations, env)
    origin = f"{source.origin}, on {source.chip}{source.scales}"
    files = policy_in_c(program, codec, seen, origin, prefix)
    write(files.text, folder, prefix)
    costs, without = files.costs, files.without_int16
    lines = (
        f"constants (ROM)        {costs.rom:,} bytes, and the code, with short rows of weights",
        f"variables (RAM)        {costs.ram:,} bytes, and the stack",
        f"input spikes           {costs.events:,.1f}, at most {costs.events_max:,}",
        f"synaptic operations    {costs.sops:,.1f}, at most {costs.sops_max:,}",
        f"neuron updates         {costs.neuron_updates:,}",
        f"of an inference, means of {recorded}",
        *program.remarks,
        f"no interface in 16-bit integers: {without}"
        if without
        else f"{prefix}_act_i16: observations and actions as 16-bit integers; README.md",
        f"wrote {folder}: {', '.join(files.text)}",
        f"compare with the interpreter: make -C {quote(str(folder))} test",
    )
    facts = {"costs": asdict(costs), "recorded": recorded, "remarks": list(program.remarks)}
    return ExportResult(folder, tuple(files.text), (), {**facts, "int16": not without}, lines)


def _export_float(
    file: Path, folder: Path, observations: int, prefix: str, env: str | None
) -> ExportResult:
    """Write the C of an ONNX file, and compare its actions with the float network's."""
    controller, network = OnnxController(file), quantise_network(read_onnx(file))
    scales = network.observations

    def walk() -> Observations:
        if where:
            say(f"{where} has not this policy's {size} observations: a random walk stands for it")
        middle, half = (scales.low + scales.high) / 2, (scales.high - scales.low) / 2
        steps = np.random.default_rng(0).normal(0, 0.05, (observations, len(half)))
        drift = np.clip(np.cumsum(steps, axis=0), -0.75, 0.75)
        return np.asarray((middle + half * drift) / 2.0**scales.exponent)

    named = controller.metadata.get("env", "")
    where, size = named if is_ours(named) else "", len(scales.exponent)
    seen, recorded = observations_of(lambda: controller, where, size, observations, walk, env)
    texts = mlp_in_c(network, seen[:_INT8_STEPS], f"{origin_of(file)}, in 8-bit weights", prefix)
    write(texts, folder, prefix)
    found = action_as_floats(network.act(scales.quantise(seen)), network.chooses)
    apart = np.abs(found - np.asarray(controller.replay(seen)).reshape(found.shape))
    largest = float((apart > 0).mean() if network.chooses else apart.max())
    facts = {"weights": network.weights, "largest_difference": largest, "recorded": recorded}
    lines = (
        f"weights of 8 bits      {network.weights:,} that are not 0",
        f"{largest:.2%} of choices differ from the float network's, on {recorded}"
        if network.chooses
        else f"actions differ from the float network's by at most {largest:.4f}, on {recorded}",
        f"wrote {folder}: {', '.join(texts)}",
        f"compare with the specification in Python: make -C {quote(str(folder))} test",
    )
    return ExportResult(folder, tuple(texts), (), facts, lines)


def is_export(folder: Path) -> bool:
    """True where the folder has an earlier export, or what one left that was killed."""
    whole = os.path.lexists(folder / MAKEFILE)
    return has_text(folder / (MAKEFILE if whole else RECORD), MARK)


def write(texts: Mapping[str, str], folder: Path, prefix: str) -> None:
    """Write the files; those of an earlier export that this one has not are removed.

    They are of another policy, and a firmware that still names them would call both.
    """
    write_texts(texts, folder)
    for name in set(file_names(prefix)) - set(texts):
        if not (path := folder / name).is_symlink() and has_text(path, MARK):
            path.unlink()
