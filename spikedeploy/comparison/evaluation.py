"""Closed loop: one policy in its environment, or every entry of a line-up on the same seeds."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from itertools import islice
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import numpy as np

from spikedeploy import envs, zoo
from spikedeploy.comparison.episodes import (
    Episode,
    EpisodeJob,
    period_of,
    play,
    summarise,
)
from spikedeploy.console import progress, say
from spikedeploy.envs.repeats import check_repeats
from spikedeploy.envs.rollout import EpisodeRecorder, rollout
from spikedeploy.evaluation_setup import DEFAULT, Setup
from spikedeploy.jobs import local_pool
from spikedeploy.outputs import mark
from spikedeploy.policies.registry import (
    FLOAT,
    Candidate,
    Entry,
    check_fit,
    confirm,
    find,
    open_policy,
)
from spikedeploy.realtime.paced_loop import PacedLoop
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.seeds import EVALUATION
from spikedeploy.video import Frame, Pace, add_caption, mp4

if TYPE_CHECKING:
    from spikedeploy.comparison.comparison import Comparison

# of the shipped policies, in table order: the more a control sees and can compute, the later
_CONTROLS = ("phase", "bilinear", "fourier", "linear", "mlp-8", "mlp-16", "mlp-32", "mlp-64",
             "pruned", "small")  # fmt: skip


def line_up(
    env: str,
    files: Sequence[str],
    chips: Sequence[str] | None,
    teacher: Candidate | None = None,
    setup: Setup = DEFAULT,
) -> list[Entry]:
    """Float ANNs, float SNNs, each SNN on each chip, built-in players and the shipped controls.

    env: short name or id of the environment
    files: policies to compare; none stands for the shipped ones of the environment
    chips: for those that spike; None stands for that which each was trained for, or the default
    teacher: a row beside the files; one that is a network is the float ANN
    setup: setup of all entries
    """
    spec = envs.spec(env)
    short = spec.short
    shipped = [find(str(path)) for path in zoo.policies(short)]
    chosen = [find(file) for file in files] or shipped
    if teacher is not None:
        chosen = [teacher, *(candidate for candidate in chosen if candidate != teacher)]
    if not chosen:
        how = f"train {short} --recipe ppo-snn" if spec.foreign else "train"
        raise ConfigError(
            f"no policies are shipped for {short} yet: name files or run folders, or train one "
            f"with `spikedeploy {how}`"
        )
    chosen = _distinct(chosen)
    networks = _of_kind("ann", chosen) or _of_kind("ann", shipped)
    ann = Entry(networks[0], setup=setup) if networks else None
    entries = [ann] if ann else []
    entries += [Entry(candidate, None, ann, setup) for candidate in networks[1:]]
    for candidate in _of_kind("snn", chosen):
        exported = candidate.format == ".nir"  # a run folder is torch, which no chip runs
        on = ([candidate.default_chip] if chips is None else chips) if exported else ()
        entries += _on_chips(candidate, on, ann, setup)
    controls = [find(name) for name in spec.controls]
    order = {name: place for place, name in enumerate(_CONTROLS)}
    others = dict.fromkeys(_of_kind("control", [*chosen, *shipped]))
    ranked = sorted(others, key=lambda control: order.get(control.name, len(order)))
    controls += [each for each in ranked if each not in controls]
    # what looks at no observation has no actions for those of others
    return entries + [
        Entry(each, None, None if each.format == "expert" else ann, setup) for each in controls
    ]


def make_entries(candidate: Candidate, chip: str | None, setup: Setup = DEFAULT) -> list[Entry]:
    """A policy without baselines: one that spikes as its float twin and on the chip."""
    if candidate.kind != "snn":
        return [Entry(candidate, setup=setup)]
    return _on_chips(candidate, (chip,), None, setup)


def _on_chips(
    candidate: Candidate, chips: Sequence[str | None], ann: Entry | None, setup: Setup
) -> list[Entry]:
    """A spiking policy in float and on chips.

    One that was trained in a chip's integers has no float twin: its file read in float is another
    network.
    """
    twin = None if candidate.chip else Entry(candidate, FLOAT, ann, setup)
    rows = [Entry(candidate, chip, twin or ann, setup) for chip in chips]
    return rows if twin is None else [twin, *rows]


def _of_kind(kind: str, candidates: Sequence[Candidate]) -> list[Candidate]:
    return [candidate for candidate in candidates if candidate.kind == kind]


def _distinct(candidates: Sequence[Candidate]) -> list[Candidate]:
    """The candidates, with the folder in the name where names would be equal."""
    names = [candidate.name for candidate in candidates]
    return [
        replace(candidate, name=f"{Path(candidate.path).parent.name}/{candidate.name}")
        if names.count(candidate.name) > 1
        else candidate
        for candidate in candidates
    ]


def compare_policies(
    env: str,
    entries: Sequence[Entry],
    seeds: Sequence[int],
    processes: int | None = None,
) -> "Comparison":
    """Play every entry on every seed, in parallel, references before those that refer to them.

    env: short name or id of the environment
    entries: rows of line_up; the reference of an entry is an entry too, all share a setup
    seeds: (n,) from EVALUATION up, which no training uses
    processes: one for each core by default
    """
    setup, references = entries[0].setup, [id(entry.reference) for entry in entries]
    _check(env, setup.options(), entries, seeds)
    for remark in filter(None, (entry.remark for entry in entries)):
        say(remark)
    played: dict[Entry, list[Episode]] = {}
    with (
        TemporaryDirectory() as folder,
        local_pool(processes) as pool,
        progress(f"{env}: {len(entries)} policies", len(entries) * len(seeds)) as done,
    ):

        def file(entry: Entry, seed: int) -> Path:
            return Path(folder) / f"{entries.index(entry)}-{seed}.npz"

        def job(entry: Entry, seed: int) -> EpisodeJob:
            others = {other.label: file(other, seed) for other in entry.references}
            record = file(entry, seed) if id(entry) in references else None
            return EpisodeJob(env, entry, seed, others, record)

        for rank in range(1 + max(entry.rank for entry in entries)):
            group = [entry for entry in entries if entry.rank == rank]
            todo = [job(entry, seed) for entry in group for seed in seeds]
            found = iter(pool.in_order(play, todo, done))
            for entry in group:
                played[entry] = list(islice(found, len(seeds)))
    from spikedeploy.comparison.comparison import Comparison, PolicyRow

    spec, rows = envs.spec(env), [PolicyRow(entry, played[entry]) for entry in entries]
    return Comparison(spec.id, seeds, rows, spec.foreign, period_of(env, setup))


def _check(
    env: str, options: Mapping[str, Any], entries: Sequence[Entry], seeds: Sequence[int]
) -> None:
    """Refuse training seeds, policies of other environments and unknown chips at once."""
    if min(seeds) < EVALUATION:
        raise ConfigError(
            f"seed {min(seeds)} may have been trained on; evaluation starts at {EVALUATION}"
        )
    world = envs.make(env, **options)
    for entry in entries:
        check_fit(entry.candidate, world)
        if entry.on_chip:
            chip(str(entry.chip))  # raises on an unknown name
    world.close()
    if remark := check_repeats(env, options):
        say(remark)


def run_policy(
    reference: str,
    env: str | None,
    chip: str | None,
    seeds: Sequence[int],
    setup: Setup = DEFAULT,
    video: Path | None = None,
    loop: PacedLoop | None = None,
    hardware: Any = None,  # noqa: ANN401
) -> "Comparison":
    """Play the policy on every seed; return its row.

    reference: as registry.find takes it
    env: short name or id; None is the one that the policy was made for
    chip: a chip or "float"; None is that of the training, or DEFAULT_CHIP, for a file that spikes
    seeds: (n,)
    video: MP4 of the first episode
    loop: paces the episodes by the clock and chooses the seeds; None plays at full speed
    hardware: shipping.verilog.CoreDriver that computes in place of the emulated chip
    """
    candidate = find(reference)
    played_with = setup
    if hardware is not None:
        candidate = replace(candidate, name=hardware.name)
        played_with = replace(setup, backend=hardware.backend)
    entry = Entry(candidate, chip or candidate.default_chip, setup=setup)
    if setup.faults and not entry.on_chip:
        raise ConfigError(
            f"--fault is of chips, and {entry.label} runs in float. Leave it out, or run a spiking "
            "policy on a chip."
        )
    if remark := entry.remark:
        say(remark)
    mode = "rgb_array" if video else None
    name = env or candidate.env
    if name is None:
        raise ConfigError(f"{candidate.path} does not say for which environment: give --env")
    if env is None:
        confirm(name, None, candidate.path)
    foreign = envs.spec(name).foreign
    world: Any = envs.make(name, **setup.options(), render_mode=mode)
    opened = open_policy if loop is None else loop.open
    controller = opened(candidate, entry.chip, world, played_with)
    period = world.unwrapped.CONTROL_DT
    episodes: list[Episode] = []
    with progress(entry.label, len(seeds)) as done:
        for seed in seeds if loop is None else loop.seeds(seeds):
            if loop is not None:
                played = loop.rollout(world, controller, seed)
            elif video and not episodes:
                with _film(video, entry.label, world) as on_step:
                    played = rollout(world, controller, seed, on_step)
            else:
                played = rollout(world, controller, seed)
            episodes.append(summarise(controller, played, {}, setup.metric, foreign))
            done()
    if remark := getattr(world.unwrapped, "remark", ""):
        say(remark)
    world.close()
    from spikedeploy.comparison.comparison import Comparison, PolicyRow  # after the first action

    if loop is not None:  # it may have played more
        seeds = range(seeds[0], seeds[0] + len(episodes))
    return Comparison(played.env_id, seeds, [PolicyRow(entry, episodes)], foreign, period)


@contextmanager
def _film(path: Path, caption: str, world: Any) -> Iterator[Callable[[EpisodeRecorder], None]]:  # noqa: ANN401
    """The callback of a rollout that writes an MP4."""
    pace = Pace.for_period(world.unwrapped.CONTROL_DT)
    with mp4(path, pace.fps, mark("run")) as write:

        def show(episode: EpisodeRecorder) -> None:
            if episode.steps % pace.every == 0:
                write(add_caption(_picture(world), caption))

        yield show


def _picture(world: Any) -> Frame:  # noqa: ANN401
    try:
        drawn = world.render()
    except NotImplementedError:  # of gymnasium, where the environment defines no render
        drawn = None
    if not isinstance(drawn, np.ndarray):
        raise ConfigError(
            '--video: render() of the environment returns no picture with render_mode="rgb_array"'
        )
    return drawn
