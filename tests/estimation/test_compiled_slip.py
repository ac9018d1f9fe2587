"""Wheels that contradict each other, compiled. Truth: the averages and velocities by NumPy's algebra; both back ends."""

from __future__ import annotations

import numpy as np
import pytest

from toys import made
from wbmpc.bases.swerve.slipping_wheels import CONTRADICTS, HOLD, OVER, SlippingWheels
from wbmpc.bases.swerve.wheel_odometry import WheelOdometry
from wbmpc.kernel.step import Backend
from wbmpc.model.robot import load_robot

GEOMETRY = load_robot("swerve-ur10").base.geometry


@pytest.mark.parametrize("backend", ["compiled", "interpreted"])
@pytest.mark.parametrize("gyro", [True, False])
def test_what_wheels_contradict(backend: Backend, gyro: bool) -> None:
    rng, h = np.random.default_rng(3), 0.0025
    wheels = WheelOdometry(GEOMETRY)
    slipping = made(backend, SlippingWheels, GEOMETRY, wheels)
    leg, steer, wheel = np.zeros(4), np.zeros(4), np.zeros(4)
    contradiction, velocity, found = np.zeros((4, 2)), np.zeros((4, 2)), 0
    for k in range(60):
        leg, steer = leg + 1e-3 * rng.normal(size=4), steer + 1e-3 * rng.normal(size=4)
        wheel = wheel + h * np.array([1.0, 1.0, 1.0, 1.0 if k < 30 else 4.0])
        wheels.update(leg, steer, wheel)
        turn, before = 1e-4 * rng.normal(), slipping.odd.copy()
        slipping.update(h, leg, turn if gyro else None)
        residual, (dx, dy, dyaw) = wheels.residual, wheels.increment
        x, y = GEOMETRY.steer_axes(leg).T
        seen = (residual + [dx, dy] + (dyaw - turn) * np.stack([-y, x], axis=1)) / h
        share = 1.0 - np.exp(-h / OVER)
        contradiction += share * (residual / h - contradiction)
        velocity += share * (seen - velocity) if gyro else 0.0
        np.testing.assert_allclose(slipping._contradiction, contradiction.ravel(), atol=1e-12)
        np.testing.assert_allclose(slipping.seen, velocity.ravel(), atol=1e-12)
        held = np.isclose(slipping.odd, HOLD)
        np.testing.assert_allclose(slipping.odd[~held], np.maximum(before - h, 0.0)[~held])
        if np.sum(contradiction**2) < CONTRADICTS**2:
            assert not held.any()
        found += bool(held[3])
    assert found > 5  # the wheel that turns four times as fast
