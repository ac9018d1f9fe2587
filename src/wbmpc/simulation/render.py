"""Pictures of a plant's state, with MuJoCo's renderer (needs no screen)."""

from __future__ import annotations

import importlib
import os
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from types import TracebackType
from typing import Literal, Protocol

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from wbmpc.errors import WbmpcError
from wbmpc.mujoco_start import OPENGL, without_screen
from wbmpc.simulation.world import SUN

Image = NDArray[np.uint8]
Color = tuple[int, int, int]
#: Colors (0 to 255) of what is drawn over a robot: its end effector's reference, its way, predicted ways of end effector and base.
REFERENCE, TRAIL, END_EFFECTOR, BASE = (230, 70, 30), (60, 70, 85), (30, 110, 220), (40, 160, 90)
#: Width of lines over the height of a picture. Points of the shadow map for each row of a picture, and at most: more are not seen, and
#: cost most of a small picture. Sides of round bodies, in pictures of up to so many rows and in larger ones.
_WIDTH, _SHADOW, _SHADOWS = 1.0 / 110.0, 4.0, 4096
_SMALL, _SIDES, _MORE_SIDES = 540, (20, 10, 2), (28, 16, 4)
#: A camera whose picture ends so far below the horizon [rad] sees the floor alone: the sky behind it is not drawn.
_HORIZON = -0.05
#: Lines are drawn to such a share of a picture's height: half of their width.
_OFF_LINE = 0.5 * _WIDTH
#: A shadow on the floor: what brings a point (3) there along the sun's rays, nearly flat (what is flat has no normals), how high above the
#: floor [m], and its color.
_TO_FLOOR = np.array([[1.0, 0.0, -SUN[0] / SUN[2]], [0.0, 1.0, -SUN[1] / SUN[2]], [0.0, 0.0, 1e-4]])
_ABOVE, _SHADE = np.array([0.0, 0.0, 0.002]), np.array([0.45, 0.47, 0.5, 1.0], np.float32)
#: What casts none.
_FLAT = (int(mujoco.mjtGeom.mjGEOM_PLANE), int(mujoco.mjtGeom.mjGEOM_LINE))


class Drawable(Protocol):
    """A plant that can be drawn."""

    model: mujoco.MjModel
    data: mujoco.MjData


@dataclass(frozen=True)
class Camera:
    """A view. ``target`` (3) [m]: from the base's position on the floor (world axes) if ``follow``, else in the world.

    ``azimuth`` and ``elevation`` [rad] of the direction of view; ``distance`` [m]; ``field`` of view, vertical [rad].
    """

    target: tuple[float, float, float] = (0.0, 0.0, 0.45)
    distance: float = 4.0
    azimuth: float = 2.3
    elevation: float = -0.38
    field: float = 0.6
    follow: bool = True


def default_camera(plant: Drawable) -> Camera:
    """A view of the whole robot from its front left, by its size."""
    size = min(1.8 * float(plant.model.stat.extent), 4.2)
    tall = float(np.max(plant.data.xpos[1:, 2]))
    return Camera(target=(0.0, 0.1, 0.45 * tall), distance=max(2.0, size))


class Renderer:
    """Draws one plant: ``frame`` gives RGB pictures (height, width, 3).

    ``shadows``: "all", on the "floor" alone, which takes half of the time without a graphics card, or "none". ``samples`` of every
    pixel: with 4 edges are smooth, with 0 a picture takes half of the time.
    """

    def __init__(
        self, plant: Drawable, width: int = 960, height: int = 540, *, shadows: Literal["all", "floor", "none"] = "all", samples: int = 4
    ) -> None:  # fmt: skip
        self.plant, self._height, model = plant, height, plant.model
        _use_egl_without_screen()
        # not a pixel more: without a graphics card, clearing a large buffer takes as long as drawing a small picture
        model.vis.global_.offwidth, model.vis.global_.offheight = width, height
        quality = model.vis.quality
        quality.offsamples = samples
        quality.shadowsize = min(_SHADOWS, 2 ** round(np.log2(_SHADOW * height)))
        quality.numslices, quality.numstacks, quality.numquads = _SIDES if height <= _SMALL else _MORE_SIDES
        self._on_floor = shadows == "floor"
        self._width, self._brightness = max(1.0, _WIDTH * height), 0.5 if shadows == "all" else 1.0
        try:
            self._renderer = mujoco.Renderer(model, height, width)
        except (ImportError, RuntimeError, mujoco.FatalError) as error:
            raise WbmpcError(f"no picture: OpenGL does not start ({error}); try MUJOCO_GL=egl or osmesa") from error
        flags = self._renderer.scene.flags
        flags[mujoco.mjtRndFlag.mjRND_SHADOW] = shadows == "all"
        flags[mujoco.mjtRndFlag.mjRND_REFLECTION] = False
        flags[mujoco.mjtRndFlag.mjRND_HAZE] = False

    def frame(self, camera: Camera | None = None, lines: Sequence[tuple[Color, ArrayLike]] = ()) -> Image:
        """The present state; ``lines``: polylines in the world, each a color (0 to 255) and points (m, 3) [m], as a reference path of
        the end effector. Points that are not finite are left out."""
        model, data = self.plant.model, self.plant.data
        mujoco.mj_kinematics(model, data)
        mujoco.mj_camlight(model, data)
        camera = camera or default_camera(self.plant)
        view = mujoco.MjvCamera()
        base = [float(data.qpos[0]), float(data.qpos[1]), 0.0] if camera.follow else [0.0, 0.0, 0.0]
        view.lookat[:] = np.add(base, camera.target)
        view.distance = camera.distance
        view.azimuth, view.elevation = np.degrees(camera.azimuth), np.degrees(camera.elevation)
        model.vis.global_.fovy = float(np.degrees(camera.field))
        top = camera.elevation + 0.5 * camera.field
        self._renderer.scene.flags[mujoco.mjtRndFlag.mjRND_SKYBOX] = top > _HORIZON
        self._renderer.update_scene(data, view)
        if self._on_floor:
            self._cast_on_floor()
        seen = 2.0 * camera.distance * np.tan(0.5 * camera.field)  # height of what is seen there [m]
        for color, points in lines:
            self._draw(color, np.asarray(points, float).reshape(-1, 3), _OFF_LINE * seen)
        picture: Image = self._renderer.render()
        return picture

    def _cast_on_floor(self) -> None:
        """Shadows as flat bodies on the floor: MuJoCo's own draw all of the picture once more."""
        scene = self._renderer.scene
        for i in range(min(scene.ngeom, scene.maxgeom - scene.ngeom)):
            body, shadow = scene.geoms[i], scene.geoms[scene.ngeom]
            if body.type in _FLAT or body.rgba[3] < 0.5 or body.pos[2] < 0.0:
                continue
            place, turn = _TO_FLOOR @ body.pos + _ABOVE, (_TO_FLOOR @ body.mat).ravel()
            mujoco.mjv_initGeom(shadow, body.type, np.asarray(body.size, float), place, turn, _SHADE)
            shadow.size[:] = body.size  # those of a scene's bodies are in another order than those of a model's
            shadow.dataid, shadow.specular = body.dataid, 0.0
            scene.ngeom += 1

    def _draw(self, color: Color, points: NDArray[np.float64], tolerance: float) -> None:
        points = simplified(points[np.isfinite(points).all(axis=1)], tolerance)
        scene, line = self._renderer.scene, mujoco.mjtGeom.mjGEOM_LINE
        stride = max(1, -(-len(points) // max(scene.maxgeom - scene.ngeom - 1, 1)))
        # with shadows the picture is drawn twice, and what both draw is added
        rgba = np.array([*(self._brightness * np.array(color) / 255.0), 1.0], np.float32)
        for start, end in pairwise(points[::stride]):
            geom = scene.geoms[scene.ngeom]
            mujoco.mjv_initGeom(geom, line, np.zeros(3), np.zeros(3), np.zeros(9), rgba)
            mujoco.mjv_connector(geom, line, self._width, start, end)
            scene.ngeom += 1

    def close(self) -> None:
        """Free the graphics memory."""
        self._renderer.close()

    def __enter__(self) -> Renderer:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def simplified(points: NDArray[np.float64], tolerance: float) -> NDArray[np.float64]:
    """Those of ``points`` (n, 3) [m] whose polyline is nowhere farther away from the others than ``tolerance`` [m] (Douglas and Peucker):
    every line costs as much as a body."""
    kept, parts = {0, len(points) - 1}, [(0, len(points) - 1)]
    while parts:
        start, end = parts.pop()
        if end - start < 2:
            continue
        chord, away = points[end] - points[start], points[start + 1 : end] - points[start]
        share = np.clip(away @ chord / max(chord @ chord, 1e-12), 0.0, 1.0)
        off = np.linalg.norm(away - share[:, None] * chord, axis=1)
        farthest = int(off.argmax())
        if off[farthest] > tolerance:
            middle = start + 1 + farthest
            kept.add(middle)
            parts += [(start, middle), (middle, end)]
    return points[sorted(kept)] if len(points) else points


def _use_egl_without_screen() -> None:
    """MuJoCo chooses its OpenGL back end when it is imported, by default one that needs a screen."""
    if OPENGL not in os.environ and without_screen():
        os.environ[OPENGL] = "egl"
        importlib.reload(importlib.import_module("mujoco.rendering.classic.gl_context"))
