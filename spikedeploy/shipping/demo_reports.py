"""The demo: shipped policies on three tasks, a report of each, videos of a hexapod and a kart."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice, zip_longest
from pathlib import Path
from typing import Any

from spikedeploy import envs, zoo
from spikedeploy.comparison.lineup import Entry, line_up
from spikedeploy.comparison.rounds import compare_policies
from spikedeploy.console import progress, say
from spikedeploy.envs.errors import EnvError
from spikedeploy.policies.interface import DEFAULT_CHIP
from spikedeploy.policies.registry import open_policy
from spikedeploy.reports import report
from spikedeploy.reports.terminal import print_comparison
from spikedeploy.seeds import EVALUATION
from spikedeploy.video import Frame, Pace, captioned, mp4, side_by_side

FOLDER = Path("reports/demo")
_KINDS = {"ann": "float ANN", "snn": "spiking network"}


@dataclass(frozen=True)
class _DemoTask:
    """What the demo shows of a task.

    episodes  of its report
    seconds   of its video; 0 for none. A frame of the hexapod takes 0.2 s without a GPU
    """

    episodes: int
    seconds: float = 0.0


_TASKS = {
    "hexapod": _DemoTask(episodes=4, seconds=3.5),
    "hexapod-command": _DemoTask(episodes=3),
    "kart-steer": _DemoTask(episodes=10, seconds=15.0),
}


def write_demo(
    folder: Path = FOLDER, quiet: bool = False, everything: bool = True
) -> list[dict[str, Any]]:
    """Compare the shipped policies of every task; return the reports as data.

    folder  for report.json, report.html, plots and video of the first task; the other tasks get
            folders inside it
    quiet   write nothing to stdout
    everything  print all tables, else one for each task
    """
    documents: list[dict[str, Any]] = []
    for env, task in _TASKS.items():
        if not zoo.policies(env):
            say(f"{env}: no policies are shipped yet")
            continue
        into = folder if not documents else folder / env
        entries = line_up(env, (), (DEFAULT_CHIP,))
        seeds = range(EVALUATION, EVALUATION + task.episodes)
        document = report.document(compare_policies(env, entries, seeds))
        video = _film(env, entries, into / "film.mp4", task.seconds) if task.seconds else None
        files = report.write(document, into, video)
        documents.append(document)
        if not quiet:
            print_comparison(document, everything)
            say(f"→ {files[0]}{f' and {video}' if video else ''}\n")
    return documents


def _film(env: str, entries: Sequence[Entry], path: Path, seconds: float) -> Path | None:
    """A video of the float ANN beside the SNNs on the chip; None where nothing can render."""
    ann = [e for e in entries if e.candidate.kind == "ann"][:1]
    snns = [e for e in entries if e.chip == DEFAULT_CHIP]
    if not ann or not snns:
        return None
    pace = _pace(env)
    count = round(seconds * pace.fps)
    try:
        with mp4(path, pace.fps) as write, progress("film", count) as drawn:
            filmed = (_frames(env, entry) for entry in [*ann, *snns])
            for frames in islice(_together(*filmed), count):
                write(side_by_side(*frames))
                drawn()
    except EnvError as error:
        say(f"no film: {error}")
        return None
    return path


def _action(action: Any) -> Any:  # noqa: ANN401
    """An action as environments take it: a choice as an int."""
    return action if action.shape else int(action)


def _pace(env: str) -> Pace:
    world: Any = envs.make(env)
    pace = Pace.of(world.unwrapped.CONTROL_DT)
    world.close()
    return pace


def _together(*films: Iterator[Frame]) -> Iterator[tuple[Frame, ...]]:
    """A frame of each film until all have ended; a shorter one keeps its last frame."""
    kept: tuple[Frame | None, ...] = (None,) * len(films)
    for new in zip_longest(*films):
        kept = tuple(old if now is None else now for old, now in zip(kept, new, strict=True))
        shown = tuple(frame for frame in kept if frame is not None)
        if len(shown) == len(films):
            yield shown


def _frames(env: str, entry: Entry) -> Iterator[Frame]:
    """Frames of one episode of an entry."""
    world: Any = envs.make(env, render_mode="rgb_array")
    player = open_policy(entry.candidate, entry.chip, world)
    pace, caption = _pace(env), f"{_KINDS[entry.candidate.kind]}: {entry.label}"
    observation, _ = world.reset(seed=EVALUATION)
    player.reset(EVALUATION)
    for step in range(world.unwrapped.max_steps):
        if step % pace.every == 0:
            yield captioned(world.render(), caption)
        observation, _, terminated, _, _ = world.step(_action(player.act(observation)))
        if terminated:
            yield captioned(world.render(), caption)
            break
    world.close()
