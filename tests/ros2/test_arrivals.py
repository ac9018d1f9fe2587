"""Odometry where messages do not arrive as they are stamped. Truth: a turn at a constant rate by the stamps, which wheels that roll
without slip make and a gyro without bias reads."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from wbmpc.bases import base_type
from wbmpc.model.robot import load_robot
from wbmpc.model.wheels import rolling_inverse_kinematics
from wbmpc.ros2.joints import Inertial, JointSample
from wbmpc.ros2.settings import joint_groups, settings_of

PERIOD, RATE, STEPS = 0.0025, 0.6, 800
#: Times [s] between arrivals: of a simulator that takes three times as long, of bursts after 40 ms.
SLOW = np.full(STEPS, 3.0 * PERIOD)
BURSTS = np.where(np.arange(STEPS) % 16 == 0, 16 * PERIOD - 15e-4, 1e-4)


def turning(robot: Any) -> dict[str, np.ndarray]:
    """Positions by group of a base that stands, and the rates of its wheels when it turns at 1 rad/s ("rates")."""
    groups = {g: np.zeros(len(names)) for g, names in joint_groups(robot).items()}
    if "steer" in robot.state.groups:
        geometry, leg = robot.base.geometry, robot.home[robot.state["leg"]]
        steer, rates = rolling_inverse_kinematics(geometry, leg, groups["steer"], (0.0, 0.0, 1.0))
        return {**groups, "leg": leg, "steer": steer, "rates": rates}
    return {**groups, "rates": np.linalg.pinv(robot.base.twist)[:, 2]}


@pytest.mark.parametrize("arrivals", [SLOW, BURSTS], ids=["slow", "bursts"])
@pytest.mark.parametrize("name", ["swerve-ur10", "differential-ur10"])
def test_the_gyro_counts_over_the_time_between_stamps(name: str, arrivals: np.ndarray) -> None:
    robot = load_robot(name)
    adapter = base_type(robot.description.base.type).ros(robot, settings_of(robot)(), PERIOD)
    groups = turning(robot)
    wheel, rates = groups["wheel"], groups.pop("rates")
    yaw, at = 0.0, 100.0
    for k in range(2 * STEPS):
        turn = RATE if k > STEPS else 0.0  # the bias of the gyro is known by then
        yaw += turn * PERIOD
        wheel = wheel + rates * turn * PERIOD
        at += arrivals[k % STEPS]
        imu = Inertial(np.array([0.0, 0.0, turn]), np.array([0.0, 0.0, 9.81]), np.array([0.0, 0.0, turn]))
        sample = JointSample(7.0 + k * PERIOD, {**groups, "wheel": wheel})
        adapter.stand(adapter.measurement(at, at, sample, imu))
    seen = adapter.snapshot()
    assert seen is not None
    assert seen[1][robot.state["base"]][2] == pytest.approx(yaw, abs=2e-3)
