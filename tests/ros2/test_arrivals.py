"""Odometry where messages do not arrive as they are stamped. Truth: a turn at a constant rate by the stamps, which wheels that roll
without slip make and a gyro without bias reads."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from effort import some
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


@pytest.mark.parametrize(
    ("name", "arrivals"),
    some([(n, a) for n in ("swerve-ur10", "differential-ur10") for a in (SLOW, BURSTS)], [1, 2]),
)
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


def test_what_waited_while_a_process_was_held_up_moves_the_base() -> None:
    """A swerve robot goes straight on, one wheel slips; for a second its messages wait, and come at once. Truth: the way of the others."""
    robot = load_robot("swerve-ur10")
    adapter = base_type(robot.description.base.type).ros(robot, settings_of(robot)(), PERIOD)
    groups, at, way, slipped = turning(robot), 100.0, 0.0, 0.0
    groups.pop("rates")
    geometry, leg = robot.base.geometry, robot.home[robot.state["leg"]]
    steer, rates = rolling_inverse_kinematics(geometry, leg, groups["steer"], (1.0, 0.0, 0.0))
    rng, still = np.random.default_rng(0), Inertial(np.zeros(3), np.array([0.0, 0.0, 9.81]), np.zeros(3))
    for k in range(2400):
        held_up = 1600 < k < 2000
        way += 0.5 * PERIOD * min(max(0.01 * (k - 400), 0.0), 1.0)
        at += 400 * PERIOD if k == 1600 else 1e-5 if held_up else PERIOD
        slipped += 0.05 * PERIOD * (1500 < k < 2000)
        turned = rates * (way + slipped * np.eye(4)[0])
        wheel = 2e-4 * np.round((turned + 1e-4 * rng.normal(size=4)) / 2e-4)  # as encoders count
        sample = JointSample(7.0 + k * PERIOD, {**groups, "leg": leg, "steer": steer, "wheel": wheel})
        adapter.stand(adapter.measurement(at, at, sample, still))
    seen = adapter.snapshot()
    assert seen is not None
    assert seen[1][robot.state["base"]] == pytest.approx([way, 0.0, 0.0], abs=0.03)
