"""The moving picture of README: robots driven by emulated chips, above their spikes.

    python -m lab film [-o docs/screenshots/robots.webp] [POLICY@ENV ...]

Each policy plays one evaluation episode on Loihi 1. Below it pass the spikes of the last two
seconds, input events above hidden neurons, and the synaptic operations so far in a mean control
step.
"""

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from lab.experiments.runner import ROOT
from spikedeploy.make_env import make_env
from spikedeploy.policies.nir import NirController
from spikedeploy.policies.registry import find
from spikedeploy.recordings import last_inference, ledger_of, open_with_traces
from spikedeploy.runtime.files import replacing
from spikedeploy.seeds import EVALUATION

SHOWN = ("hexapod/sparse@hexapod", "examples/quadrotor.nir@examples.quadrotor:Quadrotor")
CHIP = "loihi1"
_WIDTH, _HEIGHT, _RASTER = 360, 270, 96  # of a picture and of the spikes below [pixels]
_SECONDS, _PAST = 5.0, 2.0  # of the film, and of the spikes that are shown
_FPS = 12.5
_DARK, _LIGHT = (24, 28, 36), (235, 238, 245)
_EVENTS, _HIDDEN = (86, 180, 233), (230, 159, 0)  # sky blue, orange (Wong 2011)
_BYTES = 2_000_000  # most of the file


@dataclass(frozen=True)
class FilmedStep:
    """A frame (H, W, 3) of a robot, and what its chip did until then.

    spikes  (S, N) input events and hidden spikes, in the control steps so far
    inputs  how many of them are inputs
    sops    mean of a control step
    title   the environment, or how many steps went onto forbidden tiles
    """

    frame: NDArray[np.uint8]
    spikes: NDArray[np.bool_]
    inputs: int
    sops: float
    title: str


def play(policy: str, env: str) -> Iterator[tuple[FilmedStep, float]]:
    """Steps of an episode at the frame rate of the film, and the time of a control step [s]."""
    world: Any = make_env(env, {}, render_mode="rgb_array")
    player = open_with_traces(find(policy), CHIP, world, "each")
    assert isinstance(player, NirController)
    period = getattr(world.unwrapped, "CONTROL_DT", None) or 1 / world.metadata["render_fps"]
    player.reset(EVALUATION)
    seen, _ = world.reset(seed=EVALUATION)
    past: list[NDArray[np.bool_]] = []
    every = round(1 / (_FPS * period))
    for step in range(round(_SECONDS / period)):
        seen, _, terminated, truncated, info = world.step(player.act(seen))
        spikes = last_inference(player).spikes
        rows = {name: (each != 0).any(0) for name, each in spikes.items()}
        inputs = rows.pop("input")
        past.append(np.concatenate([inputs, *rows.values()]))
        if step % every == 0:
            ledger = ledger_of(player)
            sops = ledger.per_inference("sop") if ledger else 0.0
            title = env.partition(":")[2] or env
            if "missteps" in info:
                title = f"{info['missteps']} of {info['touchdowns']} steps on red"
            frame = np.asarray(world.render())
            yield FilmedStep(frame, np.array(past), len(inputs), sops, title), period
        if terminated or truncated:
            break
    world.close()


def draw(moment: FilmedStep, period: float) -> Image.Image:
    """The frame over the spikes of the last seconds, with a line of text between."""
    picture = Image.fromarray(moment.frame)
    scale = max(_WIDTH / picture.width, _HEIGHT / picture.height)
    picture = picture.resize((round(scale * picture.width), round(scale * picture.height)))
    left, top = (picture.width - _WIDTH) // 2, (picture.height - _HEIGHT) // 2
    whole = Image.new("RGB", (_WIDTH, _HEIGHT + 22 + _RASTER), _DARK)
    whole.paste(picture.crop((left, top, left + _WIDTH, top + _HEIGHT)), (0, 0))
    pen, font = ImageDraw.Draw(whole), ImageFont.load_default(size=14)
    pen.text((8, _HEIGHT + 3), moment.title, font=font, fill=_LIGHT)
    count = f"{moment.sops:,.0f} SOPs a control step"
    pen.text((_WIDTH - 8, _HEIGHT + 3), count, font=font, fill=_LIGHT, anchor="ra")
    recent = moment.spikes[-round(_PAST / period) :]
    top, rows = _HEIGHT + 24, _RASTER - 8
    # as many rows for events as they are of all, and a quarter at least
    above = min(round(rows * max(moment.inputs / recent.shape[1], 0.25)), rows - 8)
    both = (
        (recent[:, : moment.inputs], above, _EVENTS),
        (recent[:, moment.inputs :], rows - above, _HIDDEN),
    )
    for spikes, high, colour in both:
        if not spikes.shape[1]:  # no hidden neuron
            continue
        bright = np.cbrt(shares(spikes, high)).T[..., None]  # one of eight is half as bright
        pixels = np.array(_DARK) + bright * (np.array(colour) - _DARK)
        wide = max(round(_WIDTH * len(recent) / round(_PAST / period)), 1)
        part = Image.fromarray(pixels.round().astype(np.uint8)).resize(
            (wide, high), Image.Resampling.BOX
        )
        whole.paste(part, (_WIDTH - wide, top))
        top += high
    return whole


def shares(spikes: NDArray[np.bool_], rows: int) -> NDArray[np.float64]:
    """Share of the neurons (S, N) that spike, in each of so many rows (S, rows) of equal height."""
    ends = np.linspace(0, spikes.shape[1], rows + 1)
    sums = np.concatenate([np.zeros((len(spikes), 1)), np.cumsum(spikes, 1)], 1)
    until = np.stack([np.interp(ends, np.arange(sums.shape[1]), each) for each in sums])
    found: NDArray[np.float64] = np.diff(until, axis=1) * (rows / spikes.shape[1])
    return found


def write(shown: Sequence[str], path: Path) -> int:
    """Write the film of policies at environments, side by side; return its size [bytes]."""
    films = []
    for each in shown:
        policy, _, env = each.partition("@")
        films.append([draw(moment, period) for moment, period in play(policy, env)])
    images = []
    for parts in zip(*films, strict=False):
        whole = Image.new("RGB", (len(parts) * (_WIDTH + 6) - 6, parts[0].height), (255, 255, 255))
        for place, part in enumerate(parts):
            whole.paste(part, (place * (_WIDTH + 6), 0))
        images.append(whole)
    with replacing(path) as file:
        images[0].save(
            file, format="WEBP", save_all=True, append_images=images[1:], loop=0, quality=55,
            duration=round(1000 / _FPS), method=4,
        )  # fmt: skip
    return path.stat().st_size


def main() -> int:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("shown", nargs="*", metavar="POLICY@ENV", default=list(SHOWN))
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "docs/screenshots/robots.webp")
    given = parser.parse_args()
    size = write(given.shown, given.output)
    print(f"{given.output}: {size:,} bytes{', too many' if size > _BYTES else ''}")
    return int(size > _BYTES)
