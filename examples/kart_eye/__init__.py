"""kart-eye: a kart that sees corridors, forks and signs by an event camera.

signs.py     words as they are or mirrored, and chevrons, drawn anew for every sign
course.py    corridors, forks, gates and textures of an episode
view.py      first-person views, ray by ray
batch.py     EyeBatch: many karts at once, options, physics, events, the teacher
env.py       KartEye: one of them as an environment
picture.py   pictures: the view, the events, the map
networks.py  EyeSnn: a network for `--network`
"""

from typing import Any

from examples.kart_eye.env import KartEye

__all__ = ["EyeSnn", "KartEye"]


def __getattr__(name: str) -> Any:  # noqa: ANN401
    if name == "EyeSnn":  # loads torch and snnTorch
        from examples.kart_eye.networks import EyeSnn

        return EyeSnn
    raise AttributeError(name)
