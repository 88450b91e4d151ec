"""The last inferences of a spiking policy, and the panel that draws them."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pygame
from numpy.typing import NDArray

from spikedeploy.play.panel import (
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
    """S inferences of T timesteps each, at most WINDOW.

    rasters: "input" and every spiking layer -> (S, T, N) uint8
    scores: (S, act) mean readout, before an action is made of it
    """

    rasters: dict[str, NDArray[np.uint8]]
    scores: Floats

    @classmethod
    def stack(cls, each: Sequence[tuple[Inference, Floats]]) -> "InferenceTrace":
        """Return consecutive inferences with their scores (act,); a graded spike counts as one."""
        rasters = {
            name: np.stack([one.spikes[name] != 0 for one, _ in each]).astype(np.uint8)
            for name in each[0][0].spikes
        }
        return cls(rasters, np.stack([scores for _, scores in each]))


def last_scores(player: NirController) -> tuple[Inference, Floats]:
    """Return the last inference of a traced player, and its scores (act,)."""
    controller = player.controller
    return last_inference(player), controller.codec.scores(controller.output)[0]


def draw_inferences(
    surface: pygame.Surface,
    place: pygame.Rect,
    name: str,
    trace: InferenceTrace | None,
    actions: Sequence[str],
) -> None:
    """Draw the last inferences of a policy; nothing without one.

    name: name of the policy and its chip
    actions: their names, where the environment has some
    """
    pygame.draw.rect(surface, PANEL, place)
    if trace is None:
        return
    count = trace.scores.shape[1]
    names = actions if len(actions) == count else [str(index) for index in range(count)]
    pygame.draw.line(surface, LINE, place.topleft, place.bottomleft)
    inner = place.inflate(-2 * _PAD, -2 * _PAD)
    write(surface, name, inner.topleft, 17, TEXT, "bold")
    write(surface, _NOTE, (inner.left, inner.top + 24), 12, DIM)
    pitch = min(24, 216 // count)  # of an action's row: many actions leave the spikes their room
    below = inner.bottom - 34 - pitch * count
    y = inner.top + 56
    height = (below - y - 34 * len(trace.rasters)) // len(trace.rasters)
    for index, (layer, raster) in enumerate(trace.rasters.items()):
        box = pygame.Rect(inner.left, y, inner.width, height + 20)
        _layer(surface, box, layer, raster, CYAN if index else AMBER)
        y += height + 34
    scores = pygame.Rect(inner.left, below + 8, inner.width, 0)
    _scores(surface, scores, trace.scores, names, pitch)


def _layer(
    surface: pygame.Surface,
    place: pygame.Rect,
    name: str,
    raster: NDArray[np.uint8],
    colour: Colour,
) -> None:
    """Draw a layer (S, T, N): spikes of the last inference, and mean rates of the last ones."""
    heading(surface, f"{name} · {raster.shape[2]}", place.topleft)
    share = f"{100 * raster[-1].mean():.0f} % spike"
    write(surface, share, (place.right, place.top - 2), 12, DIM, anchor="topright")
    body = pygame.Rect(place.left, place.top + 20, place.width, place.height - 20)
    left = pygame.Rect(body.topleft, (round(body.width * _SHARE), body.height))
    right = pygame.Rect(left.right + _GAP, body.top, body.right - left.right - _GAP, body.height)
    _image(surface, left, raster[-1].T.astype(np.float64), colour)
    past = np.zeros((raster.shape[2], WINDOW))
    recent = raster.mean(axis=1).T
    past[:, WINDOW - recent.shape[1] :] = recent
    _image(surface, right, past, colour)


def _image(surface: pygame.Surface, place: pygame.Rect, values: Floats, colour: Colour) -> None:
    """Draw values (N, columns) from 0 to 1 as brightness, neuron 0 on top."""
    dark, bright = np.array(TRACK), np.array(colour)
    pixels = dark + np.sqrt(values)[:, :, None] * (bright - dark)
    small = pygame.surfarray.make_surface(pixels.swapaxes(0, 1).astype(np.uint8))
    fits = values.shape[0] <= place.height
    scale = pygame.transform.scale if fits else pygame.transform.smoothscale
    surface.blit(scale(small, place.size), place)


def _scores(
    surface: pygame.Surface,
    place: pygame.Rect,
    scores: Floats,
    names: Sequence[str],
    pitch: int,
) -> None:
    """Draw a bar for each score of the last action, of (S, act)."""
    heading(surface, "action scores", place.topleft)
    largest, size = max(float(np.abs(scores).max()), 1e-9), min(13, pitch - 1)
    for index, (name, score) in enumerate(zip(names, scores[-1], strict=True)):
        y = place.top + 24 + pitch * index
        write(surface, name, (place.left, y), size, DIM)
        bar = pygame.Rect(place.left + 100, y + size // 2 - 1, place.width - 100 - 66, 7)
        signed_bar(surface, bar, float(score) / largest)
        write(surface, f"{score:+.2f}", (place.right, y), size, DIM, "mono", "topright")
