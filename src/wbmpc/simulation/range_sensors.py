"""Simulated LIDARs and depth cameras: rays in MuJoCo, with noise, a rate, and an age at delivery."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import mujoco
import numpy as np

from wbmpc.arrays import Array
from wbmpc.checks import not_negative, positive


def lidar_rays(channels: int, columns: int, low: float, high: float) -> Array:
    """Directions (channels · columns, 3) all around z, between elevations ``low`` and ``high`` [rad]."""
    up, around = np.meshgrid(
        np.linspace(low, high, channels), 2.0 * np.pi / columns * np.arange(columns), indexing="ij"
    )
    return np.stack([np.cos(up) * np.cos(around), np.cos(up) * np.sin(around), np.sin(up)], axis=-1).reshape(-1, 3)


def camera_rays(width: int, height: int, field: float, pitch: float) -> Array:
    """Directions (width · height, 3) of a pinhole camera that looks along x, ``pitch`` [rad] down; ``field`` [rad]: its horizontal field of
    view."""
    pixel = np.tan(0.5 * field) / (0.5 * width)
    aside = pixel * (0.5 * (width - 1) - np.arange(width))
    down = pixel * (np.arange(height) - 0.5 * (height - 1))
    y, z = np.meshgrid(aside, -down)
    rays = np.stack([np.ones(y.size), y.ravel(), z.ravel()], axis=1)
    c, s = np.cos(pitch), np.sin(pitch)
    rays = rays @ np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]]).T
    return np.asarray(rays / np.linalg.norm(rays, axis=1)[:, None])


@dataclass(frozen=True)
class Scan:
    """Points (n, 3) [m] in the axes of the body that carries the sensor, seen at ``time`` [s] by ``sensor``, which is at ``origin`` (3)."""

    sensor: str
    time: float
    points: Array
    origin: Array


class RangeSensor:
    """Measures along ``rays`` (n, 3), unit directions in the axes of ``body``, from ``position`` (3) [m] of it, at ``rate`` [Hz]; delivered
    ``age`` [s] later.

    Distances have normal noise with standard deviation ``noise`` [m]; where there is nothing within ``reach`` [m] a point is twice as far. It
    sees all shapes of the world, the robot's own too, all at one moment.
    """

    def __init__(
        self, name: str, rays: Array, body: str, position: Array, *, rate: float, age: float, reach: float, noise: float,
        seed: int = 0,
    ) -> None:  # fmt: skip
        positive(f"sensor '{name}'", rate=rate, reach=reach)
        not_negative(f"sensor '{name}'", age=age, noise=noise)
        self.name, self.body, self._rays, self._position = (
            name, body, np.asarray(rays, float), np.asarray(position, float),
        )  # fmt: skip
        self._period, self._age, self._reach, self._noise = 1.0 / rate, age, reach, noise
        self._random, self._due = np.random.default_rng([seed, len(rays)]), 0.0
        self._waiting: deque[Scan] = deque()

    def measure(self, t: float, model: mujoco.MjModel, data: mujoco.MjData) -> Scan:
        """What it sees now, at ``t`` [s]."""
        body, n = model.body(self.body).id, len(self._rays)
        turn = data.xmat[body].reshape(3, 3)
        eye = data.xpos[body] + turn @ self._position
        found, geoms = np.empty(n), np.empty(n, np.int32)
        world = np.ascontiguousarray(self._rays @ turn.T).reshape(-1)
        mujoco.mj_multiRay(model, data, eye, world, None, True, -1, geoms, found, None, n, self._reach)
        far = (found < 0.0) | (found > self._reach)
        distance = np.where(far, 2.0 * self._reach, np.maximum(found + self._noise * self._random.normal(size=n), 0.0))
        return Scan(self.name, t, self._position + distance[:, None] * self._rays, self._position)

    def observe(self, t: float, model: mujoco.MjModel, data: mujoco.MjData) -> tuple[bool, Scan | None]:
        """Whether it measures at ``t`` [s], and the scan that is delivered then. To be asked at least as often as scans are due."""
        due = t >= self._due - 1e-9
        if due:
            self._due += self._period
            self._waiting.append(self.measure(t, model, data))
        ready = self._waiting and t >= self._waiting[0].time + self._age - 1e-9
        return due, self._waiting.popleft() if ready else None
