"""What a simulated robot perceives of a scene: range sensors, the local map, and what of it plans know."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import Field

from wbmpc import lie
from wbmpc.arrays import Array
from wbmpc.bases.base import System
from wbmpc.log import Log
from wbmpc.mapping import LocalMap
from wbmpc.model.robot import RobotModel
from wbmpc.obstacles.geometry import robot_geometry
from wbmpc.result import Metric, Plot, Series
from wbmpc.settings import Settings
from wbmpc.simulation.range_sensors import RangeSensor, Scan, camera_rays, lidar_rays

#: How far [m] a LIDAR is above the highest part of a robot at home.
MAST = 0.15
_Place = Annotated[float, Field(ge=-100, le=100)]
_Side = Annotated[float, Field(ge=0.1, le=100)]


class SensorSettings(Settings):
    """``rate`` [Hz]; ``age`` [s] at delivery; ``reach`` [m]; ``noise`` [m]: standard deviation; ``position`` (3) [m] in the base's frame (left
    out: a LIDAR above the robot, a camera before it); ``fails`` [s]: from then on there are no scans."""

    rate: float = Field(10.0, ge=0.1, le=200)
    age: float = Field(0.05, ge=0, le=1)
    reach: float = Field(4.0, ge=0.1, le=100)
    noise: float = Field(0.01, ge=0, le=1)
    position: tuple[_Place, _Place, _Place] | None = None
    fails: float = Field(1e9, ge=0, le=1e9)


class LidarSensor(SensorSettings):
    """``channels``: number of elevations that have rays; ``columns``: rays around, of each; ``low`` [rad]: the lowest elevation; ``high`` [rad]: the
    highest."""

    channels: int = Field(24, ge=1, le=256)
    columns: int = Field(240, ge=4, le=4096)
    low: float = Field(-1.2, ge=-1.57, le=1.57)
    high: float = Field(0.1, ge=-1.57, le=1.57)


class DepthCamera(SensorSettings):
    """``width``: width of the image in pixels; ``height``: height of the image in pixels; ``field`` [rad]: field of view; ``pitch``
    [rad]: downwards."""

    width: int = Field(64, ge=2, le=640)
    height: int = Field(48, ge=2, le=480)
    field: float = Field(1.5, ge=0.1, le=3.0)
    pitch: float = Field(0.35, ge=-1.57, le=1.57)


class MapSettings(Settings):
    """``size`` [m]: size of the window (3); ``cell`` [m]: length of a cell's edge; ``max_age`` [s]: what is older ends in a
    stop; ``padding`` [m]: about the robot's own body."""

    size: tuple[_Side, _Side, _Side] = (5.0, 5.0, 1.6)
    cell: float = Field(0.04, ge=0.01, le=1)
    max_age: float = Field(0.5, ge=0.01, le=10)
    padding: float = Field(0.05, ge=0, le=1)


class PerceptionSettings(Settings):
    """A ``lidar``, a depth ``camera``, and the ``map`` of what they see."""

    lidar: LidarSensor = LidarSensor()
    camera: DepthCamera = DepthCamera()
    map: MapSettings = MapSettings()


class Perception:
    """Sensors on the base of a simulated robot and the map that they fill, in the frame of the controller's estimate."""

    def __init__(self, settings: PerceptionSettings, robot: RobotModel, system: System, log: Log, seed: int) -> None:
        self._robot, self._system, self._log = robot, system, log
        self._sensors = sensors(settings, robot, seed)
        self._fails = {"lidar": settings.lidar.fails, "camera": settings.camera.fails}
        m = settings.map
        self.map = LocalMap(
            robot, size=m.size, cell=m.cell, reach=settings.lidar.reach, padding=m.padding, max_age=m.max_age
        )
        self._states: dict[tuple[str, float], Array] = {}
        self._oldest = 0.0
        for sensor in self._sensors:  # the first plan knows what is there
            self._add(sensor.measure(0.0, system.plant.model, system.plant.data), robot.home)
        self._publish(0.0)

    def tick(self, t: float) -> None:
        """Take in what sensors deliver at ``t`` [s], and make the map known to plans."""
        system, new = self._system, False
        for sensor in self._sensors:
            if t >= self._fails[sensor.name]:
                continue
            due, scan = sensor.observe(t, system.plant.model, system.plant.data)
            if due:
                self._states[sensor.name, t] = self._state()
            if scan is not None:
                self._add(scan, self._states.pop((sensor.name, scan.time)))
                new = True
        if new:
            self._publish(t)
        self._oldest = max(self._oldest, self.map.age(t))

    def _publish(self, t: float) -> None:
        if self._system.mpc.obstacles is not None:
            self.map.publish(self._system.mpc.obstacles, t)
        self._log.add("occupied_cells", t, float(self.map.occupied.sum()))

    def _state(self) -> Array:
        """The robot's estimated state (nx)."""
        return np.array(self._system.controller.state()[: self._robot.state.size])

    def _add(self, scan: Scan, state: Array) -> None:
        position, quaternion = self._robot.pose(state, self._robot.description.base.body)
        turn = lie.quaternion_to_rotation(np.asarray(quaternion))
        self.map.add(position + scan.points @ turn.T, position + turn @ scan.origin, scan.time, state, scan.sensor)

    def metrics(self) -> dict[str, Metric]:
        """Of the map."""
        return {
            "map_age_max": Metric(self._oldest, "s"),
            "map_points_dropped": Metric(float(self.map.dropped), "1"),
        }

    def plots(self) -> list[Plot]:
        """How much is occupied over time."""
        t = self._log.times("occupied_cells")
        cells = Series("map", t, self._log.array("occupied_cells").ravel())
        return [Plot("Occupied cells", "time [s]", "cells", [cells])]


def sensors(settings: PerceptionSettings, robot: RobotModel, seed: int) -> list[RangeSensor]:
    """On the base: a LIDAR on a mast, a camera at its front; or where settings have them."""
    body = robot.description.base.body
    above, ahead = _mounts(robot, body)
    lidar, camera = settings.lidar, settings.camera
    made = (
        ("lidar", lidar_rays(lidar.channels, lidar.columns, lidar.low, lidar.high), lidar, above),
        ("camera", camera_rays(camera.width, camera.height, camera.field, camera.pitch), camera, ahead),
    )
    return [
        RangeSensor(
            name, rays, body, np.array(place if s.position is None else s.position), rate=s.rate, age=s.age, reach=s.reach,
            noise=s.noise, seed=seed,
        )
        for name, rays, s, place in made
    ]  # fmt: skip


def _mounts(robot: RobotModel, body: str) -> tuple[Array, Array]:
    """In the base's frame: a place above the whole robot, and one right before its base."""
    geometry = robot_geometry(robot)
    position, quaternion = robot.pose(robot.home, body)
    turn = lie.quaternion_to_rotation(np.asarray(quaternion))
    centers, axes = (v[0] for v in geometry.at(*geometry.kinematics(robot.home[None])))

    def end(direction: Array, base: bool) -> float:
        """How far the robot, or its base alone, reaches along a direction of the base's frame."""
        parts = [k for k, s in enumerate(geometry.shapes) if not base or s.frame == geometry.frames[0]]
        along = turn @ direction
        supports = [geometry.shapes[k].solid.support((along @ axes[k])[None])[0] @ (along @ axes[k]) for k in parts]
        return max(float((centers[k] - position) @ along + s) for k, s in zip(parts, supports, strict=True))

    x, _, z = np.eye(3)
    return np.array([0.0, 0.0, end(z, False) + MAST]), np.array([end(x, True) + 0.02, 0.0, end(z, True)])
