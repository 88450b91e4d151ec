"""The demo: shipped policies on both tasks, a report of each, and a film of two of them."""

from collections.abc import Iterator, Sequence
from itertools import islice
from pathlib import Path
from typing import Any

import envs
from envs.errors import EnvError
from spikedeploy import report, zoo
from spikedeploy.compare import compare
from spikedeploy.lineup import Entry, line_up
from spikedeploy.policies import open_policy
from spikedeploy.run import DEFAULT_CHIP
from spikedeploy.seeds import EVALUATION
from spikedeploy.terminal import print_comparison, progress, say
from spikedeploy.video import Frame, captioned, mp4, side_by_side

EPISODES = {"hexapod": 4, "hexapod-command": 3}
FOLDER = Path("reports/demo")
FPS = 25
KINDS = {"ann": "float ANN", "snn": "spiking network"}
SECONDS = 5  # drawing without a graphics card takes 0.2 s a frame


def demo(folder: Path = FOLDER, quiet: bool = False) -> list[dict[str, Any]]:
    """Compare the shipped policies of every task; the reports as data.

    folder  report.json, report.html, plots and film of the first task; the others' in folders of
            their own inside it
    quiet   write nothing to stdout
    """
    documents: list[dict[str, Any]] = []
    for env, episodes in EPISODES.items():
        if not zoo.policies(env):
            say(f"{env}: no policies are shipped yet")
            continue
        into = folder if not documents else folder / env
        entries = line_up(env, (), (DEFAULT_CHIP,))
        seeds = range(EVALUATION, EVALUATION + episodes)
        document = report.document(compare(env, entries, seeds))
        video = _film(env, entries, into / "film.mp4") if not documents else None
        files = report.write(document, into, video)
        documents.append(document)
        if not quiet:
            print_comparison(document)
            say(f"→ {files[0]}{f' and {video}' if video else ''}\n")
    return documents


def _film(env: str, entries: Sequence[Entry], path: Path) -> Path | None:
    """The float ANN beside the SNN on the chip, on the same seed; None where nothing can draw."""
    ann = next((e for e in entries if e.candidate.kind == "ann"), None)
    snn = next((e for e in entries if e.chip == DEFAULT_CHIP), None)
    if ann is None or snn is None:
        return None
    try:
        with mp4(path, FPS) as write, progress("film", FPS * SECONDS) as drawn:
            for pair in zip(_frames(env, ann), _frames(env, snn), strict=False):
                write(side_by_side(*pair))
                drawn()
    except EnvError as error:
        say(f"no film: {error}")
        return None
    return path


def _frames(env: str, entry: Entry) -> Iterator[Frame]:
    """Frames of the first seconds of an entry's episode."""
    world: Any = envs.make(env, render_mode="rgb_array")
    player = open_policy(entry.candidate, entry.chip, world)
    skip = round(1 / (FPS * world.unwrapped.CONTROL_DT))
    observation, _ = world.reset(seed=EVALUATION)
    player.reset(EVALUATION)
    for step in islice(range(world.unwrapped.max_steps), skip * FPS * SECONDS):
        if step % skip == 0:
            yield captioned(world.render(), f"{KINDS[entry.candidate.kind]}: {entry.label}")
        observation, _, terminated, _, _ = world.step(player.act(observation))
        if terminated:
            break
    world.close()
