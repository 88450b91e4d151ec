"""Keys that are pressed in windows, and windows that play events."""

import pygame

from spikedeploy.play import drive_app as window


def press(name, **more):
    """A key press, of `w` or `RETURN`."""
    return pygame.Event(pygame.KEYDOWN, key=getattr(pygame, f"K_{name}"), **more)


def release(name):
    return pygame.Event(pygame.KEYUP, key=getattr(pygame, f"K_{name}"))


class _Script:
    """Posts an event into the window at each frame, then ESC."""

    def __init__(self, app, *events):
        self._app, self._events = app, iter([*events, press("ESCAPE")])
        self.title, self.name, self.fps = app.title, app.name, 10_000.0
        self.handle, self.draw = app.handle, app.draw

    def tick(self):
        self._app.tick()
        if (event := next(self._events, None)) is not None:
            pygame.event.post(event)


def play(app, *events, **options):
    """Show the app, which gets the events, and is left by ESC if none of them leaves it."""
    window.show(_Script(app, *events), **options)
    assert not pygame.display.get_init()
    return app
