"""Colours, fonts, the shapes that panels are made of, and the picture of an environment."""

from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pygame

Colour = tuple[int, int, int]

NIGHT: Colour = (15, 18, 25)
PANEL: Colour = (22, 26, 36)
LINE: Colour = (42, 49, 64)
TRACK: Colour = (35, 41, 54)  # the empty part of a bar
TEXT: Colour = (226, 232, 243)
DIM: Colour = (134, 146, 168)
CYAN: Colour = (76, 201, 240)
AMBER: Colour = (255, 209, 102)
GREEN: Colour = (95, 211, 141)
RED: Colour = (242, 114, 123)
HEIGHT = 800  # of a window
_FONTS = {"plain": "DejaVuSans.ttf", "bold": "DejaVuSans-Bold.ttf", "mono": "DejaVuSansMono.ttf"}


@cache
def font(size: int, face: str = "plain") -> pygame.font.Font:
    """A font that ships with matplotlib, found without importing it."""
    pygame.font.init()
    spec = find_spec("matplotlib")
    if spec is None or spec.origin is None:
        return pygame.font.Font(None, size)
    return pygame.font.Font(Path(spec.origin).parent / "mpl-data/fonts/ttf" / _FONTS[face], size)


def write(
    surface: pygame.Surface,
    text: str,
    at: tuple[float, float],
    size: int = 15,
    colour: Colour = TEXT,
    face: str = "plain",
    anchor: str = "topleft",
) -> pygame.Rect:
    """Write a line of text with its `anchor`, as in pygame.Rect, at a point; return its place."""
    drawn = font(size, face).render(text, True, colour)
    place = drawn.get_rect(**{anchor: (round(at[0]), round(at[1]))})
    return surface.blit(drawn, place)


def shorten(text: str, width: int, size: int = 15, face: str = "plain") -> str:
    """The text, or its end after an ellipsis, within a width [px]."""
    cut = text
    while font(size, face).size(cut)[0] > width and len(cut) > 2:
        cut = "…" + cut[2:]
    return cut


def heading(surface: pygame.Surface, text: str, at: tuple[float, float]) -> None:
    """Write the title of a section."""
    write(surface, text.upper(), at, 11, DIM, "bold")


def bar(surface: pygame.Surface, place: pygame.Rect, share: float, colour: Colour = CYAN) -> None:
    """A bar that is filled from the left by a fraction of its length."""
    radius = place.height // 2
    pygame.draw.rect(surface, TRACK, place, border_radius=radius)
    width = round(place.width * min(max(share, 0.0), 1.0))
    if width:
        filled = pygame.Rect(place.left, place.top, max(width, place.height), place.height)
        pygame.draw.rect(surface, colour, filled, border_radius=radius)


def signed_bar(surface: pygame.Surface, place: pygame.Rect, share: float) -> None:
    """A bar from the middle: green to the right, red to the left, for shares from -1 to 1."""
    pygame.draw.rect(surface, TRACK, place, border_radius=place.height // 2)
    width = round(place.width / 2 * min(abs(share), 1.0))
    left = place.centerx if share > 0 else place.centerx - width
    if width:
        filled = pygame.Rect(left, place.top, width, place.height)
        pygame.draw.rect(surface, GREEN if share > 0 else RED, filled, border_radius=1)
    pygame.draw.line(
        surface, DIM, (place.centerx, place.top - 2), (place.centerx, place.bottom + 1)
    )


def keycaps(
    surface: pygame.Surface, entries: list[tuple[str, str]], at: tuple[float, float], width: int
) -> float:
    """Draw keys and their functions in rows; return the y below them."""
    x, y = at
    for keys, meaning in entries:
        cap, label = font(12, "bold").size(keys)[0] + 14, font(12).size(meaning)[0]
        if x + cap + 7 + label > at[0] + width:
            x, y = at[0], y + 28
        place = pygame.Rect(round(x), round(y), cap, 21)
        pygame.draw.rect(surface, LINE, place, border_radius=5)
        write(surface, keys, place.center, 12, TEXT, "bold", "center")
        write(surface, meaning, (place.right + 7, place.centery), 12, DIM, anchor="midleft")
        x = place.right + 7 + label + 18
    return y + 28


def draw_panel(
    surface: pygame.Surface,
    place: pygame.Rect,
    title: str,
    subtitle: str,
    keys: list[tuple[str, str]],
    rows: int,
) -> pygame.Rect:
    """Draw a panel with its title and, in rows at its end, the keys; return the space inside."""
    pygame.draw.rect(surface, PANEL, place)
    inner = place.inflate(-52, -52)
    write(surface, title, inner.topleft, 20, TEXT, "bold")
    write(surface, subtitle, (inner.left, inner.top + 28), 12, DIM)
    keycaps(surface, keys, (inner.left, inner.bottom - 22 - 28 * rows), inner.width)
    return inner


def banner(surface: pygame.Surface, place: pygame.Rect, text: str, colour: Colour) -> None:
    """A message over the middle of a picture."""
    width = font(26, "bold").size(text)[0] + 64
    box = pygame.Rect(0, 0, width, 72)
    box.center = place.center
    veil = pygame.Surface(box.size, pygame.SRCALPHA)
    pygame.draw.rect(veil, (*NIGHT, 228), veil.get_rect(), border_radius=14)
    pygame.draw.rect(veil, (*colour, 255), veil.get_rect(), 2, border_radius=14)
    surface.blit(veil, box)
    write(surface, text, box.center, 26, colour, "bold", "center")


def is_kart(world: Any) -> bool:  # noqa: ANN401
    """True of a kart, which is drawn on its track from above."""
    return hasattr(world, "track")


def picture_size(world: Any) -> tuple[int, int]:  # noqa: ANN401
    """Width and height of a track, or of a camera's view."""
    return (HEIGHT, HEIGHT) if is_kart(world) else (HEIGHT * 4 // 3, HEIGHT)


def env_picture(world: Any, size: tuple[int, int]) -> pygame.Surface:  # noqa: ANN401
    """A picture of this size; other environments than karts need render_mode="rgb_array"."""
    if is_kart(world):
        from spikedeploy.envs.kart.picture import drawn

        return drawn(world, size)
    frame = world.render()
    seen = pygame.surfarray.make_surface(frame.swapaxes(0, 1))
    scale = min(size[0] / seen.get_width(), size[1] / seen.get_height())
    surface = pygame.Surface(size)
    surface.fill(NIGHT)
    seen = pygame.transform.smoothscale_by(seen, scale)
    surface.blit(seen, seen.get_rect(center=surface.get_rect().center))
    return surface
