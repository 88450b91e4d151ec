"""Off-screen frames of the hexapod."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spikedeploy.envs.drawing import explain, load_renderer, without_renderer
from spikedeploy.envs.hexapod.robot import Robot

with without_renderer():
    import mujoco

_WIDTH, _HEIGHT = 640, 480  # [pixels]


class Mark(NamedTuple):
    """A flat square on the ground.

    centre: [m] (x, y)
    half: [m] half of its side
    height: [m] of its upper face
    rgba: colour
    """

    centre: tuple[float, float]
    half: float
    height: float
    rgba: tuple[float, float, float, float]


Marks = Callable[[], Iterable[Mark]]
_MOST_MARKS = 600


def _add(marks: Iterable[Mark], scene: Any) -> None:  # noqa: ANN401
    """Draw squares into a scene of MuJoCo, as many as it holds."""
    upright = np.eye(3).ravel()
    for mark, geom in zip(marks, scene.geoms[scene.ngeom : scene.maxgeom], strict=False):
        size = np.array([mark.half, mark.half, 5e-4])
        place = np.array([*mark.centre, mark.height - size[2]])
        mujoco.mjv_initGeom(geom, mujoco.mjtGeom.mjGEOM_BOX, size, place, upright, mark.rgba)
        scene.ngeom += 1


class Camera:
    """Off-screen frames of a robot, from the camera of its model that follows it.

    marks: what lies on the ground now
    """

    def __init__(
        self, subject: Robot, marks: Marks = tuple, width: int = _WIDTH, height: int = _HEIGHT
    ) -> None:
        self._model, self._data, self._marks = subject.model, subject.data, marks
        context = load_renderer()
        try:
            self._gl = context(width, height)
            self._gl.make_current()
            self._context = mujoco.MjrContext(self._model, mujoco.mjtFontScale.mjFONTSCALE_100)
        except Exception as error:  # every GL library raises its own type
            raise explain(error) from error
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._context)
        self._scene = mujoco.MjvScene(self._model, maxgeom=200 + _MOST_MARKS)
        self._scene.flags[mujoco.mjtRndFlag.mjRND_FOG] = 1
        self._view = mujoco.MjvCamera()
        self._view.type = mujoco.mjtCamera.mjCAMERA_FIXED
        self._view.fixedcamid = self._model.camera("chase").id
        self._option = mujoco.MjvOption()
        self._frame = mujoco.MjrRect(0, 0, width, height)

    def update_ground(self) -> None:
        """Upload the height field after it has changed."""
        self._gl.make_current()
        mujoco.mjr_uploadHField(self._model, self._context, 0)

    def picture(self) -> NDArray[np.uint8]:
        """Frame (H, W, 3) of the current state."""
        self._gl.make_current()
        everything = mujoco.mjtCatBit.mjCAT_ALL
        mujoco.mjv_updateScene(
            self._model, self._data, self._option, None, self._view, everything, self._scene
        )
        _add(self._marks(), self._scene)
        mujoco.mjr_render(self._frame, self._scene, self._context)
        pixels = np.empty((self._frame.height, self._frame.width, 3), np.uint8)
        mujoco.mjr_readPixels(pixels, None, self._frame, self._context)
        return np.ascontiguousarray(pixels[::-1])

    def close(self) -> None:
        """Free the OpenGL context."""
        self._gl.make_current()
        self._context.free()
        self._gl.free()
