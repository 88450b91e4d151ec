import pygame
import pytest


@pytest.fixture(autouse=True)
def dummy(monkeypatch):
    """A display that shows nothing."""
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    pygame.display.init()  # which names keys
    yield
    pygame.display.quit()
