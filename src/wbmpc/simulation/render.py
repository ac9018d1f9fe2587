"""Pictures of a plant's state, with MuJoCo's renderer (needs no screen)."""

from __future__ import annotations

import importlib
import os
import platform
from dataclasses import dataclass
from itertools import pairwise
from types import TracebackType
from typing import Protocol

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from wbmpc.errors import WbmpcError

Image = NDArray[np.uint8]


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
    """Draws one plant: ``frame`` gives RGB pictures (height, width, 3). Without ``shadows`` it is ten times faster."""

    def __init__(self, plant: Drawable, width: int = 960, height: int = 540, *, shadows: bool = True) -> None:
        self.plant, model = plant, plant.model
        _use_egl_without_screen()
        model.vis.global_.offwidth = max(width, int(model.vis.global_.offwidth))
        model.vis.global_.offheight = max(height, int(model.vis.global_.offheight))
        model.vis.quality.offsamples = 4 if shadows else 0
        try:
            self._renderer = mujoco.Renderer(model, height, width)
        except (ImportError, RuntimeError, mujoco.FatalError) as error:
            raise WbmpcError(f"no picture: OpenGL does not start ({error}); try MUJOCO_GL=egl or osmesa") from error
        flags = self._renderer.scene.flags
        flags[mujoco.mjtRndFlag.mjRND_SHADOW] = shadows
        flags[mujoco.mjtRndFlag.mjRND_REFLECTION] = False
        flags[mujoco.mjtRndFlag.mjRND_HAZE] = False

    def frame(self, camera: Camera | None = None, lines: ArrayLike | None = None) -> Image:
        """The present state; ``lines`` (m, 3) [m]: a polyline in the world, e.g. a reference path of the end effector."""
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
        self._renderer.update_scene(data, view)
        if lines is not None:
            self._draw(np.asarray(lines, float))
        return np.array(self._renderer.render(), dtype=np.uint8)

    def _draw(self, points: NDArray[np.float64]) -> None:
        scene = self._renderer.scene
        room = scene.maxgeom - scene.ngeom
        stride = max(1, -(-len(points) // max(room - 1, 1)))
        points = points[::stride]
        for start, end in pairwise(points):
            geom = scene.geoms[scene.ngeom]
            kind, color = mujoco.mjtGeom.mjGEOM_CAPSULE, np.array([0.9, 0.25, 0.1, 1.0], np.float32)
            mujoco.mjv_initGeom(geom, kind, np.zeros(3), np.zeros(3), np.zeros(9), color)
            mujoco.mjv_connector(geom, kind, 0.006, start, end)
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


def _use_egl_without_screen() -> None:
    """MuJoCo chooses its OpenGL back end when it is imported, by default one that needs a screen."""
    if "MUJOCO_GL" in os.environ or platform.system() != "Linux":
        return
    if os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"):
        return
    os.environ["MUJOCO_GL"] = "egl"
    importlib.reload(importlib.import_module("mujoco.rendering.classic.gl_context"))
