"""Spikes of a policy on the observations of an episode, and the panel that draws them."""

from collections.abc import Mapping, Sequence
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
from spikedeploy.policies.registry import Candidate
from spikedeploy.runtime.artifact.artifact import load
from spikedeploy.runtime.emulator.network import chip_called, run_network
from spikedeploy.runtime.errors import ConfigError

Floats = NDArray[np.float64]
WIDTH = 400
WINDOW = 120  # control steps of history
_PAD = 24
_GAP = 14  # between inference and history
_SHARE = 0.3  # of the width for one inference


@dataclass(frozen=True)
class InferenceTrace:
    """S inferences of T timesteps each.

    rasters  "input" and every spiking layer -> (S, T, N) uint8
    scores   (S, act) mean readout, before an action is made of it
    """

    rasters: Mapping[str, NDArray[np.uint8]]
    scores: Floats


class SpikeRecorder:
    """A spiking policy, on a chip or in float, whose spikes are recorded.

    name  for people
    """

    def __init__(self, candidate: Candidate, chip: str) -> None:
        if candidate.format != ".nir":
            raise ConfigError(
                f"{candidate.path} shows no spikes: give a .nir file, which `export` writes"
            )
        self.name = f"{candidate.name} on {chip}"
        artifact = load(candidate.path)
        if artifact.codec is None:
            raise ConfigError(f"{candidate.path} has no codec, so observations become no spikes")
        self._codec = artifact.codec
        self._graded = frozenset(artifact.sigma_delta)
        self._network = run_network(artifact, chip_called(chip), "none", trace=True)

    def record(self, observations: Floats, seed: int) -> InferenceTrace:
        """One inference for each observation (S, obs), in their order."""
        self._network.reset()
        state = self._codec.encoder.start(max(seed, 0))
        rasters: dict[str, list[NDArray[np.uint8]]] = {}
        scores = []
        for observation in observations:
            spikes = self._codec.encode(observation[None], state)
            scores.append(self._codec.scores(self._network.infer(spikes))[0])
            for name, raster in {"input": spikes, **self._network.spikes}.items():
                # a graded spike is shown as one
                shown = (raster != 0).astype(np.uint8) if name in self._graded else raster
                rasters.setdefault(name, []).append(shown[0])
        return InferenceTrace(
            {name: np.stack(rows) for name, rows in rasters.items()}, np.stack(scores)
        )


def action_names(world: Any, scores: int) -> Sequence[str]:  # noqa: ANN401
    """Names of a policy's scores."""
    names: tuple[str, ...] = getattr(world, "ACTIONS", ())
    return names if len(names) == scores else [str(index) for index in range(scores)]


def draw_inference(
    surface: pygame.Surface,
    place: pygame.Rect,
    name: str,
    inferences: InferenceTrace,
    step: int,
    actions: Sequence[str],
    taken: int | None,
) -> None:
    """Draw the panel of an inference.

    name     of the policy and its chip
    step     index of the inference
    actions  names of the scores
    taken    index of the ghost's own action, which another policy may have chosen
    """
    pygame.draw.rect(surface, PANEL, place)
    pygame.draw.line(surface, LINE, place.topleft, place.bottomleft)
    inner = place.inflate(-2 * _PAD, -2 * _PAD)
    write(surface, name, inner.topleft, 17, TEXT, "bold")
    note = f"left: this inference · right: the last {WINDOW} control steps"
    write(surface, note, (inner.left, inner.top + 24), 12, DIM)
    below = inner.bottom - 34 - _pitch(actions) * len(actions)
    y = inner.top + 56
    rasters = list(inferences.rasters.items())
    height = (below - y - 34 * len(rasters)) // len(rasters)
    for index, (layer, raster) in enumerate(rasters):
        box = pygame.Rect(inner.left, y, inner.width, height + 20)
        _layer(surface, box, layer, raster, step, CYAN if index else AMBER)
        y += height + 34
    scores = pygame.Rect(inner.left, below + 8, inner.width, 0)
    _scores(surface, scores, inferences, step, actions, taken)


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


def _image(
    surface: pygame.Surface, place: pygame.Rect, values: NDArray[np.float64], colour: Colour
) -> None:
    """Values (N, columns) from 0 to 1 as brightness, neuron 0 on top."""
    dark, bright = np.array(TRACK), np.array(colour)
    pixels = dark + np.sqrt(values)[:, :, None] * (bright - dark)
    small = pygame.surfarray.make_surface(pixels.swapaxes(0, 1).astype(np.uint8))
    fits = values.shape[0] <= place.height
    scale = pygame.transform.scale if fits else pygame.transform.smoothscale
    surface.blit(scale(small, place.size), place)


def _pitch(actions: Sequence[str]) -> int:
    """Height of an action's row [px]: many actions leave the spikes their room."""
    return min(24, 216 // len(actions))


def _scores(
    surface: pygame.Surface,
    place: pygame.Rect,
    inferences: InferenceTrace,
    step: int,
    actions: Sequence[str],
    taken: int | None,
) -> None:
    """A bar for each action score; the largest and the ghost's own action are marked."""
    scores = inferences.scores[step]
    chosen = None if taken is None else int(scores.argmax())
    heading(surface, "action scores", place.topleft)
    if taken is not None:
        write(surface, "● the ghost's", (place.right, place.top - 2), 12, DIM, anchor="topright")
    largest = max(float(np.abs(inferences.scores).max()), 1e-9)
    pitch = _pitch(actions)
    size = min(13, pitch - 1)
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
