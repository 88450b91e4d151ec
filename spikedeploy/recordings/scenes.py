"""What of an environment can be drawn: MuJoCo's bodies in space, karts on their track.

A scene is asked for its `shapes` once an episode and for a `pose` at every frame.
"""

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from spikedeploy.envs.kart.track import RADIUS
from spikedeploy.recordings.packed import packed

Floats = NDArray[np.float64]

# mujoco.mjtGeom that the page draws
_KINDS = {0: "plane", 1: "ground", 2: "sphere", 3: "capsule", 4: "ellipsoid", 5: "cylinder",
          6: "box"}  # fmt: skip
_GROUND = ("plane", "ground")
_COARSE = 0.1  # [m] spacing of the heights that are kept of rough ground
_DECOR = 2  # MuJoCo's visualiser hides geoms of higher groups


class DrawnScene(Protocol):
    """What there is to draw in an environment."""

    def shapes(self) -> dict[str, Any]:
        """What does not move in an episode, as JSON: `kind` and the shapes."""

    def pose(self) -> Floats:
        """What moves, (N, 7) positions and quaternions of bodies or (1, 3) x, y, heading."""


def scene_of(env: Any) -> DrawnScene | None:  # noqa: ANN401
    """The scene of an environment; None of one that shows nothing that we know."""
    inner = env.unwrapped
    # of environments that wrap other people's
    inner = getattr(inner, "inner", inner).unwrapped
    body = getattr(inner, "robot", inner)  # of our hexapods; gymnasium's hold both themselves
    if hasattr(body, "model") and hasattr(getattr(body, "data", None), "xquat"):
        return _Bodies(body.model, body.data)
    if hasattr(inner, "track") and hasattr(inner, "pose"):
        return _Kart(inner)
    return None


class _Bodies:
    """The bodies of a MuJoCo model and the geoms fixed to them."""

    def __init__(self, model: Any, data: Any) -> None:  # noqa: ANN401
        self._model, self._data = model, data

    def shapes(self) -> dict[str, Any]:
        """Geoms in the frames of their bodies, and the heights of the ground."""
        model = self._model
        kinds = [_KINDS.get(int(kind), "") for kind in model.geom_type]
        shown = [g for g, kind in enumerate(kinds) if kind and self._is_shown(g)]
        solid = [g for g in shown if kinds[g] not in _GROUND]
        return {
            "kind": "bodies",
            "geoms": [
                {
                    "kind": kinds[g],
                    "body": int(model.geom_bodyid[g]) - 1,
                    "size": _rounded(model.geom_size[g]),
                    "position": _rounded(model.geom_pos[g]),
                    "quaternion": _rounded(model.geom_quat[g]),
                    "colour": _rounded(self._colour(g)[:3]),
                }
                for g in solid
                if model.geom_bodyid[g] > 0
            ],
            "ground": self._ground([g for g in shown if kinds[g] in _GROUND]),
        }

    def pose(self) -> Floats:
        """(N, 7) of the bodies besides the world."""
        return np.concatenate([self._data.xpos[1:], self._data.xquat[1:]], axis=1)

    def _is_shown(self, geom: int) -> bool:
        return bool(self._colour(geom)[3] > 0 and self._model.geom_group[geom] <= _DECOR)

    def _colour(self, geom: int) -> Floats:
        material = int(self._model.geom_matid[geom])
        own = material < 0 or not np.allclose(self._model.geom_rgba[geom], [0.5, 0.5, 0.5, 1])
        found = self._model.geom_rgba[geom] if own else self._model.mat_rgba[material]
        return np.asarray(found, np.float64)

    def _ground(self, geoms: list[int]) -> dict[str, Any] | None:
        """Height of a plane, or heights (rows along y, columns along x) of rough ground."""
        if not geoms:
            return None
        model, geom = self._model, geoms[0]
        height = float(model.geom_pos[geom, 2])
        field = int(model.geom_dataid[geom])
        if field < 0:
            return {"height": height}
        rows, columns = int(model.hfield_nrow[field]), int(model.hfield_ncol[field])
        x, y, top, _ = (float(each) for each in model.hfield_size[field])
        start = int(model.hfield_adr[field])
        heights = model.hfield_data[start : start + rows * columns].reshape(rows, columns)
        every = max(1, round(_COARSE * (columns - 1) / (2 * x)))
        kept = height + top * heights[::every, ::every]
        return {"height": height, "half": [x, y], "heights": packed(kept)}


class _Kart:
    """A kart on its track."""

    def __init__(self, env: Any) -> None:  # noqa: ANN401
        self._env = env

    def shapes(self) -> dict[str, Any]:
        """Walls and gates [px]; y points down."""
        track = self._env.track
        return {
            "kind": "track",
            "walls": _rounded(track.walls, 1),
            "gates": _rounded(track.gates, 1),
            "radius": RADIUS,
        }

    def pose(self) -> Floats:
        """(1, 3) x [px], y [px] and heading [rad]."""
        return np.array([self._env.pose])


def _rounded(values: Any, digits: int = 4) -> Any:  # noqa: ANN401
    return np.round(np.asarray(values, np.float64), digits).tolist()
