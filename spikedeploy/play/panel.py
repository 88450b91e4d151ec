"""Colours, fonts, and the panel beside the picture of an environment."""

from functools import cache
from importlib.util import find_spec
from pathlib import Path

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
    middle, width = place.centerx, round(place.width / 2 * min(abs(share), 1.0))
    if width:
        left = middle if share > 0 else middle - width
        filled = pygame.Rect(left, place.top, width, place.height)
        pygame.draw.rect(surface, GREEN if share > 0 else RED, filled, border_radius=1)
    pygame.draw.line(surface, DIM, (middle, place.top - 2), (middle, place.bottom + 1))


class Panel:
    """A panel beside a picture: a title, sections from the top down, the keys at its end.

    surface: what it is drawn on
    inner: the space inside
    y: of the next section [px]
    """

    def __init__(
        self,
        surface: pygame.Surface,
        place: pygame.Rect,
        title: str,
        subtitle: str,
        keys: list[tuple[str, str]],
    ) -> None:
        pygame.draw.rect(surface, PANEL, place)
        self.surface, self.inner = surface, place.inflate(-52, -52)
        self.y = self.inner.top
        self.text(title, 0, 20, TEXT, "bold")
        self.text(subtitle, 28, 12)
        self._draw_keys(keys, self.inner.bottom - 50)
        self.y += 66

    def title(self, text: str, below: int = 0) -> None:
        """The title of a section, so far below its beginning."""
        heading(self.surface, text, (self.inner.left, self.y + below))

    def text(
        self, text: str, below: int, size: int, colour: Colour = DIM, face: str = "plain"
    ) -> pygame.Rect:
        """Text at the left."""
        return write(self.surface, text, (self.inner.left, self.y + below), size, colour, face)

    def value(
        self, text: str, below: int, size: int, colour: Colour = TEXT, face: str = "plain"
    ) -> None:
        """Text at the right."""
        place = self.inner.right, self.y + below
        write(self.surface, text, place, size, colour, face, "topright")

    def columns(self, cells: list[tuple[str, str, Colour]], size: int) -> None:
        """Titles, and a text in its colour below each, in three columns."""
        for column, (title, text, colour) in enumerate(cells):
            x = self.inner.left + column * self.inner.width // 3
            heading(self.surface, title, (x, self.y))
            write(self.surface, text, (x, self.y + 17), size, colour, "bold")

    def bar(self, share: float, below: int, height: int, colour: Colour = CYAN) -> None:
        """A bar over the whole width."""
        place = pygame.Rect(self.inner.left, self.y + below, self.inner.width, height)
        bar(self.surface, place, share, colour)

    def _draw_keys(self, entries: list[tuple[str, str]], y: int) -> None:
        x = self.inner.left
        for keys, meaning in entries:
            cap, label = font(12, "bold").size(keys)[0] + 14, font(12).size(meaning)[0]
            if x + cap + 7 + label > self.inner.right:
                x, y = self.inner.left, y + 28
            place = pygame.Rect(x, y, cap, 21)
            pygame.draw.rect(self.surface, LINE, place, border_radius=5)
            write(self.surface, keys, place.center, 12, TEXT, "bold", "center")
            at = place.right + 7, place.centery
            write(self.surface, meaning, at, 12, DIM, anchor="midleft")
            x = place.right + 25 + label


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
