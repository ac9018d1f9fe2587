"""The baseline of rolling inverse kinematics at the end of a wheel's range. Truth: the steering's own integral."""

from __future__ import annotations

import numpy as np

from toys import robot
from wbmpc.studies.pankert2022.rolling import RollingController

ROBOT = robot("swerve-fixed-ur10")


def test_a_wheel_whose_target_is_the_end_of_its_range_turns_about_once() -> None:
    """The target goes to and fro across the end, as that of a base that drives on does; the wheel must not follow it to and fro."""
    controller = RollingController(
        ROBOT, np.zeros(3), 0.0025, lambda t: ((np.zeros(3), np.zeros(3)), (np.zeros(4), np.zeros(4)))
    )
    end = float(ROBOT.limits.state_upper[ROBOT.state["steer"]][0])
    steer, wheel = np.full(4, end - 1.3), np.ones(4)
    for k in range(800):
        way = end + 0.01 * np.sin(0.3 * k)
        raw = way + np.pi * np.round((steer - way) / np.pi)  # the nearer way round
        target, rolled = controller._within(raw, np.where(np.round((steer - way) / np.pi) == 0.0, wheel, -wheel))
        steer = steer + 0.0025 * np.clip(12.0 * (target - steer), -5.0, 5.0)
    np.testing.assert_allclose(np.abs(np.sin(steer - way)), 0.0, atol=0.05)
    assert (np.abs(rolled) == 1.0).all()
