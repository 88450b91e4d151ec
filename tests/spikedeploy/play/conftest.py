import pygame
import pytest

from spikedeploy.envs import drawing


@pytest.fixture(autouse=True)
def dummy(monkeypatch):
    """A display that shows nothing."""
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    monkeypatch.setattr(drawing, "_sdl_is_ours", False)  # a user chose it
    pygame.display.init()  # which names keys
    yield
    pygame.display.quit()
