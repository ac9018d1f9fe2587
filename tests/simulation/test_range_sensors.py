"""Simulated range sensors. Truth: closed forms of a floor, a wall and a ball."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from wbmpc.errors import InputError
from wbmpc.simulation.range_sensors import RangeSensor, camera_rays, lidar_rays

PLACE, YAW = np.array([0.3, -0.2, 0.8]), 0.7
MOUNT = np.array([0.1, 0.0, 0.4])


def world() -> tuple[mujoco.MjModel, mujoco.MjData]:
    """A wall at x = 2 m, a floor at 0, a body that carries sensors."""
    spec = mujoco.MjSpec()
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 0.1])
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.1, 5, 5], pos=[2.1, 0, 0])
    body = spec.worldbody.add_body(name="base", pos=PLACE, quat=[np.cos(0.5 * YAW), 0, 0, np.sin(0.5 * YAW)])
    body.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.05, 0, 0])
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return model, data


def sensor(rays: np.ndarray, **changes: float) -> RangeSensor:
    settings = {"rate": 10.0, "age": 0.05, "reach": 3.0, "noise": 0.0, **changes}
    return RangeSensor("lidar", rays, "base", MOUNT, **settings)  # type: ignore[arg-type]


def in_world(points: np.ndarray) -> np.ndarray:
    c, s = np.cos(YAW), np.sin(YAW)
    return PLACE + points @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]).T


def test_points_are_on_the_wall_and_on_the_floor_or_beyond_the_reach() -> None:
    rays = lidar_rays(9, 36, -0.8, 0.4)
    scan = sensor(rays).measure(0.0, *world())
    eye, points = in_world(MOUNT), in_world(scan.points)
    ahead = in_world(MOUNT + rays) - eye
    with np.errstate(divide="ignore"):
        wall = np.where(ahead[:, 0] > 0, (2.0 - eye[0]) / ahead[:, 0], np.inf)
        floor = np.where(ahead[:, 2] < 0, -eye[2] / ahead[:, 2], np.inf)
    truth = np.minimum(wall, floor)
    own = np.linalg.norm(points - PLACE, axis=1) < 0.05 + 1e-6  # it sees its own body
    expected = eye + np.where(truth <= 3.0, truth, 6.0)[:, None] * ahead
    np.testing.assert_allclose(points[~own], expected[~own], atol=1e-6)
    assert (truth <= 3.0).any() and (truth > 3.0).any()


def test_a_camera_sees_a_rectangle_of_its_field() -> None:
    rays = camera_rays(64, 48, 1.2, 0.0)
    np.testing.assert_allclose(np.linalg.norm(rays, axis=1), 1.0)
    flat = rays / rays[:, :1]
    half = np.tan(0.6)
    assert flat[:, 1].max() == pytest.approx(half * 63 / 64) and flat[:, 2].max() == pytest.approx(half * 47 / 64)
    down = camera_rays(65, 49, 1.2, 0.3)[24 * 65 + 32]  # the one in the middle
    np.testing.assert_allclose(down, [np.cos(0.3), 0.0, -np.sin(0.3)], atol=1e-12)


def test_noise_is_along_the_rays() -> None:
    rays = np.tile([1.0, 0.0, 0.0], (4000, 1))
    exact = sensor(rays[:1]).measure(0.0, *world()).points[0]
    off = sensor(rays, noise=0.02).measure(0.0, *world()).points - exact
    assert np.abs(off[:, 1:]).max() < 1e-12
    assert abs(off[:, 0].mean()) < 0.002 and off[:, 0].std() == pytest.approx(0.02, rel=0.1)


def test_scans_come_at_their_rate_and_with_their_age() -> None:
    rays, (model, data) = lidar_rays(1, 4, 0.0, 0.0), world()
    lidar, times = sensor(rays, rate=10.0, age=0.05), []
    for k in range(100):
        due, scan = lidar.observe(0.005 * k, model, data)
        assert due == (k % 20 == 0)
        if scan is not None:
            times.append((0.005 * k, scan.time))
    np.testing.assert_allclose(times, [(0.05 + 0.1 * k, 0.1 * k) for k in range(5)], atol=1e-9)


def test_a_sensor_has_a_rate() -> None:
    with pytest.raises(InputError, match="sensor 'lidar'"):
        sensor(lidar_rays(1, 4, 0, 0), rate=0.0)
