"""Spikes of a policy on the observations of an episode, and the panel that draws them."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pygame
from numpy.typing import NDArray

from spikedeploy.play.theme import (
    AMBER,
    CYAN,
    DIM,
    LINE,
    PANEL,
    TEXT,
    TRACK,
    Colour,
    heading,
    signed_bar,
    write,
)
from spikedeploy.policies.nir import NirController
from spikedeploy.recordings import Inference, last_inference

Floats = NDArray[np.float64]
WIDTH = 400
WINDOW = 120  # control steps of history
_PAD = 24
_GAP = 14  # between inference and history
_SHARE = 0.3  # of the width for one inference
_NOTE = f"left: this inference · right: the last {WINDOW} control steps"


@dataclass(frozen=True)
class InferenceTrace:
    """S inferences of T timesteps each.

    rasters  "input" and every spiking layer -> (S, T, N) uint8
    scores   (S, act) mean readout, before an action is made of it
    """

    rasters: dict[str, NDArray[np.uint8]]
    scores: Floats

    @classmethod
    def of(cls, each: Sequence[tuple[Inference, Floats]]) -> "InferenceTrace":
        """Consecutive inferences with their scores (act,); a graded spike is shown as one."""
        rasters = {
            name: np.stack([one.spikes[name] != 0 for one, _ in each]).astype(np.uint8)
            for name in each[0][0].spikes
        }
        return cls(rasters, np.stack([scores for _, scores in each]))


def last_scores(player: NirController) -> tuple[Inference, Floats]:
    """The last inference of a traced player, and its scores (act,)."""
    controller = player.controller
    return last_inference(player), controller.codec.scores(controller.output)[0]


def trace_of(player: NirController, observations: Floats, seed: int) -> InferenceTrace:
    """One inference of a traced player for each observation (S, obs), in their order."""
    player.reset(max(seed, 0))
    found = []
    for observation in observations:
        player.act(observation)
        found.append(last_scores(player))
    return InferenceTrace.of(found)


def draw_inference(
    surface: pygame.Surface,
    place: pygame.Rect,
    name: str,
    inferences: InferenceTrace | None,
    step: int,
    world: Any,  # noqa: ANN401
    taken: int | None,
) -> None:
    """Draw the panel of an inference; empty without one.

    name   of the policy and its chip
    step   index of the inference; the last one for larger ones
    world  whose actions have names
    taken  index of the ghost's own action, which another policy may have chosen
    """
    pygame.draw.rect(surface, PANEL, place)
    if inferences is None:
        return
    step, count = min(step, len(inferences.scores) - 1), inferences.scores.shape[1]
    named = getattr(world, "ACTIONS", ())
    actions = list(named) if len(named) == count else [str(index) for index in range(count)]
    pygame.draw.line(surface, LINE, place.topleft, place.bottomleft)
    inner = place.inflate(-2 * _PAD, -2 * _PAD)
    write(surface, name, inner.topleft, 17, TEXT, "bold")
    write(surface, _NOTE, (inner.left, inner.top + 24), 12, DIM)
    pitch = min(24, 216 // count)  # of an action's row: many actions leave the spikes their room
    below = inner.bottom - 34 - pitch * count
    y = inner.top + 56
    height = (below - y - 34 * len(inferences.rasters)) // len(inferences.rasters)
    for index, (layer, raster) in enumerate(inferences.rasters.items()):
        box = pygame.Rect(inner.left, y, inner.width, height + 20)
        _layer(surface, box, layer, raster, step, CYAN if index else AMBER)
        y += height + 34
    scores = pygame.Rect(inner.left, below + 8, inner.width, 0)
    _scores(surface, scores, inferences.scores, step, actions, taken, pitch)


def _layer(
    surface: pygame.Surface,
    place: pygame.Rect,
    name: str,
    raster: NDArray[np.uint8],
    step: int,
    colour: Colour,
) -> None:
    """One layer (S, T, N): the spikes of one inference, and the mean rates of the last ones."""
    heading(surface, f"{name} · {raster.shape[2]}", place.topleft)
    share = f"{100 * raster[step].mean():.0f} % spike"
    write(surface, share, (place.right, place.top - 2), 12, DIM, anchor="topright")
    body = pygame.Rect(place.left, place.top + 20, place.width, place.height - 20)
    left = pygame.Rect(body.topleft, (round(body.width * _SHARE), body.height))
    right = pygame.Rect(left.right + _GAP, body.top, body.right - left.right - _GAP, body.height)
    _image(surface, left, raster[step].T.astype(np.float64), colour)
    past = np.zeros((raster.shape[2], WINDOW))
    recent = raster[max(0, step + 1 - WINDOW) : step + 1].mean(axis=1).T
    past[:, WINDOW - recent.shape[1] :] = recent
    _image(surface, right, past, colour)


def _image(surface: pygame.Surface, place: pygame.Rect, values: Floats, colour: Colour) -> None:
    """Values (N, columns) from 0 to 1 as brightness, neuron 0 on top."""
    dark, bright = np.array(TRACK), np.array(colour)
    pixels = dark + np.sqrt(values)[:, :, None] * (bright - dark)
    small = pygame.surfarray.make_surface(pixels.swapaxes(0, 1).astype(np.uint8))
    fits = values.shape[0] <= place.height
    scale = pygame.transform.scale if fits else pygame.transform.smoothscale
    surface.blit(scale(small, place.size), place)


def _scores(
    surface: pygame.Surface,
    place: pygame.Rect,
    every: Floats,
    step: int,
    actions: Sequence[str],
    taken: int | None,
    pitch: int,
) -> None:
    """A bar for each action score; the largest and the ghost's own action are marked."""
    scores = every[step]
    chosen = None if taken is None else int(scores.argmax())
    heading(surface, "action scores", place.topleft)
    if taken is not None:
        write(surface, "● the ghost's", (place.right, place.top - 2), 12, DIM, anchor="topright")
    largest, size = max(float(np.abs(every).max()), 1e-9), min(13, pitch - 1)
    for index, name in enumerate(actions):
        y = place.top + 24 + pitch * index
        colour = AMBER if index == chosen else DIM
        write(surface, name, (place.left, y), size, colour, "bold" if index == chosen else "plain")
        bar = pygame.Rect(place.left + 100, y + size // 2 - 1, place.width - 100 - 84, 7)
        signed_bar(surface, bar, float(scores[index]) / largest)
        value = f"{scores[index]:+.2f}"
        write(surface, value, (place.right - 18, y), size, colour, "mono", "topright")
        if index == taken:
            pygame.draw.aacircle(surface, TEXT, (place.right - 5, y + 9), 4)
