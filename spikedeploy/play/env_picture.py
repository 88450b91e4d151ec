"""The picture of an environment: a kart on its track, or the camera's frame."""

from typing import Any

import pygame

from spikedeploy.play.theme import NIGHT


def is_kart(world: Any) -> bool:  # noqa: ANN401
    """Whether it is a kart, which is drawn on its track from above."""
    return hasattr(world, "track")


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
