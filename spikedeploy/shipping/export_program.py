"""A policy as the kit of a chip: its integers, an input, what is expected, a script of its tool."""

from collections.abc import Mapping
from pathlib import Path
from string import Template
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikedeploy import envs
from spikedeploy.emulation.rasters import read_inputs
from spikedeploy.envs import archive
from spikedeploy.envs.rollout import EpisodeRecorder, Rollout
from spikedeploy.exporters.check import ExportResult
from spikedeploy.exporters.to_program import (
    EPISODE,
    EXPECTED,
    HOST,
    HOST_CODEC,
    MARK,
    PROGRAM,
    README,
    ChipRun,
    ChipTool,
    KitPlayer,
    check_delays,
    chip_run,
    clock_text,
    expected_text,
    host_record,
    program_text,
    script,
    tool_of,
)
from spikedeploy.outputs import check_output_folder, has_text
from spikedeploy.policies.registry import confirm
from spikedeploy.runtime.artifact.artifact import Artifact
from spikedeploy.runtime.chips.chip import chip as chip_named
from spikedeploy.runtime.chips.quantisation import PLAIN, Granularity
from spikedeploy.runtime.compiler.compile import clock_on, compile_program
from spikedeploy.runtime.compiler.rules import place
from spikedeploy.runtime.convention import Clock, Reset
from spikedeploy.runtime.errors import ConfigError, TraceError
from spikedeploy.runtime.files import write_text
from spikedeploy.runtime.traces.verdict import Verdict
from spikedeploy.runtime.traces.verify import verify
from spikedeploy.seeds import VALIDATION
from spikedeploy.shipping.sources import (
    SpikingSource,
    is_ours,
    named_env,
    require_output,
    world_of,
)


def export_program(
    policy: str,
    path: Path | None,
    *,
    chip: str | None = None,
    quantise: Granularity = PLAIN.granularity,
    clock: Clock | None = None,
    observations: int = 1000,
    env: str | None = None,
    raster: Path | None = None,
    written_by: str | None = None,
    dt: float | None = None,
    reset: Reset | None = None,
    force: bool = False,
) -> ExportResult:
    """Write the kit of a policy, or of a network without a codec, for a chip.

    path: path of the folder.
    chip: None is that of its training, or the default.
    quantise: whether neurons have scales of their own.
    clock: as of compile_program; None is the network's own, or free.
    observations: control steps of the episode from which the input comes; timesteps of a raster.
    env: in which the episode is played; None is what the policy names, of ours.
    raster: file with input spikes in chip timesteps, instead of an episode.
    written_by, dt, reset: as of artifact.load.
    force: whether files that no earlier export wrote are replaced.
    """
    folder = require_output(path, "a folder", "kit")
    reading = {"written_by": written_by, "dt": dt, "reset": reset}
    source = SpikingSource.read(policy, "program", chip, quantise, **reading)
    artifact, tool = source.artifact, tool_of(source.chip)
    # nengo-loihi's whole emulator delivers one timestep later, as its synapses do
    on = chip_named(source.chip, **({"delay": 1} if source.chip == "loihi1-nengo" else {}))
    names = (PROGRAM, EXPECTED, README, HOST, HOST_CODEC, tool.script, EPISODE)
    inputs = (source.file, policy, raster)
    check_output_folder("-o", folder, names, inputs, force, lambda at: has_text(at / PROGRAM, MARK))
    if clock is None:  # tools hold no layer, so that a gated network runs free if it can
        wanted = clock_on(artifact.convention, on)
        clock = "free" if wanted == "gated" and "free" in on.clocks else wanted
    compiled = compile_program(artifact, on, source.quantisation, clock)
    codec, episode = None, None
    if raster is not None:
        given = _read_raster(artifact, raster, observations)
        run = chip_run(compiled, len(given))
        rows, recorded = run.rows(given), f"the raster {raster.name}"
    else:
        codec = source.require_codec(", or give a raster: --input spikes.npy")
        run = chip_run(compiled, codec.timesteps, artifact.convention.state)
    host = host_record(compiled, codec, run)
    if codec is not None:
        if "missing" in host:
            raise ConfigError(f"--to program: no episode: {host['missing']}. Give --input.")
        player = KitPlayer(host, run)
        rows, episode, recorded = _play(source, player, observations, env)
    check_delays(run.program, tool)
    placement = place(artifact, on).mapping if on.limits is not None else None
    origin = f"{source.origin}{source.scales}"
    text = program_text(run, compiled.clock, placement, host, origin)
    said = f"expected by spikedeploy's emulation of {source.chip}, {recorded}"
    expected = expected_text(run, rows, text, said)
    verdict = _verify_text(text, expected)
    readme = _readme(tool, run, compiled.clock, origin, recorded, episode, host)
    scripts = {name: script(name) for name in (HOST, HOST_CODEC, tool.script)}
    _write_files(folder, text, episode, {**scripts, README: readme, EXPECTED: expected})
    kept = tuple(name for name in names if name != EPISODE or episode is not None)
    open_loop = [f"no closed loop: {host['missing']}"] if "missing" in host else []
    remarks = [*compiled.remarks, *open_loop]
    facts = {"tool": tool.name, "passed": verdict.equal, "compared": verdict.compared}
    facts |= {"timesteps": verdict.steps, "recorded": recorded, "remarks": remarks}
    lines = (
        *remarks,
        f"{EXPECTED}: {verdict.compared:,} numbers of {verdict.steps} chip timesteps, {recorded}",
        f"wrote {folder}: {', '.join(kept)}",
        f"next: {folder}/{README}",
    )
    return ExportResult(folder, kept, (), facts, lines)


def _write_files(
    folder: Path, program: str, episode: Rollout | None, texts: Mapping[str, str]
) -> None:
    # first what says whose the folder is, last what names the program: a part is no kit
    write_text(folder / PROGRAM, program)
    if episode is not None:
        fields = ("observation", "action", "reward", "seed")  # what a closed loop is compared with
        archive.write(
            folder / EPISODE, {name: np.asarray(getattr(episode, name)) for name in fields}
        )
    else:
        (folder / EPISODE).unlink(missing_ok=True)
    for name, content in texts.items():
        write_text(folder / name, content)


def _verify_text(text: str, expected: str) -> Verdict:
    """The verdict of `verify` on a kit before it is written."""
    with TemporaryDirectory() as apart:
        Path(apart, PROGRAM).write_text(text, "utf-8")
        Path(apart, EXPECTED).write_text(expected, "utf-8")
        try:
            verdict = verify(Path(apart, EXPECTED))
        except TraceError as error:
            raise ConfigError(f"--to program: {error} Give fewer --observations.") from error
    if not verdict.equal:
        raise TypeError(f"what was written is not what was compiled: {verdict.difference}")
    return verdict


def _read_raster(artifact: Artifact, path: Path, most: int) -> NDArray[np.uint8]:
    """(T, M) of the raster in a file, the first timesteps."""
    found = read_inputs(path, artifact)
    if not isinstance(found, np.ndarray):
        raise ConfigError(f"--input {path}: --to program takes one raster (T, M), as .npy.")
    rows = found.reshape(len(found), -1)[:most]
    width = sum(int(np.prod(node.input_type["input"])) for node in artifact.graph.inputs.values())
    if rows.shape[1] != width or rows.dtype.kind not in "bu" or not len(rows):
        raise ConfigError(
            f"--input {path}: it has shape {found.shape} of {found.dtype}; the network takes "
            f"(T, {width}) spikes. Give a raster of this network."
        )
    return rows.astype(np.uint8)


def _play(
    source: SpikingSource, player: KitPlayer, steps: int, named: str | None
) -> tuple[NDArray[np.uint8], Rollout, str]:
    """Input (T, M) of the policy's first control steps in its environment, and that episode."""
    found = named_env(source.artifact)
    where = named or world_of(source.name, source.artifact) or found
    if not where:
        raise ConfigError(
            f"--to program: {source.name} names no environment. Name one with --env, or give a "
            "raster: --input spikes.npy."
        )
    if where == found:
        confirm(found, named, source.name)
    env = envs.make(where)
    try:
        recorder = EpisodeRecorder(env, VALIDATION[0])
        while not recorder.over and recorder.steps < steps:
            recorder.step(player.act(recorder.observation))
        played = recorder.rollout()
    finally:
        env.close()
    words = f"{played.steps} control steps in {where}, seed {VALIDATION[0]}"
    return np.concatenate(player.rows), played, words


def _readme(
    tool: ChipTool,
    run: ChipRun,
    clock: str,
    origin: str,
    source: str,
    episode: Rollout | None,
    host: Mapping[str, Any],
) -> str:
    """The text of README.md."""
    # the interpreter of the environment that `install` makes
    python = f"{tool.install.split(' -m venv ')[1].split()[0]}/bin/python"
    flags = " --sim" if "--sim" in tool.offline else ""
    closed = f"No loop: {host.get('missing', 'a raster')}."
    if episode is not None:
        ours = is_ours(episode.env_id)
        pip = f"{python} -m pip install"
        closed = Template(script("loop.md")).substitute(
            run=f"{python} {tool.script}{flags}",
            board=tool.board.splitlines()[-1].removesuffix(" --steps 5"),
            name=tool.name,
            env=f"spikedeploy:{episode.env_id}" if ours else episode.env_id,
            needs=f"{pip} CHECKOUT     # of spikedeploy" if ours else f"{pip} gymnasium",
            reset=", with `reset` between two of them" if run.state == "reset" else "",
        )
    fields = vars(tool) | {
        "origin": origin,
        "chip": run.program.chip.name,
        "clock": clock_text(run, clock),
        "python": python,
        "flags": flags,
        "source": source,
        "loop": closed.rstrip(),
    }
    return Template(script(README)).substitute(fields)
