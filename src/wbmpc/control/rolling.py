"""The rival without MPC: base and leg references straight through the rolling inverse kinematics.

The twist that the reference asks for, corrected by the base's and the legs' errors, gives each wheel its heading and speed
(Pankert et al. 2022, equations 4 and 5, solved for the wheels). It looks neither ahead nor at limits, but for scaling
the whole motion to the fastest wheel and holding it back while wheels still turn.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from wbmpc.control.swerve import SwerveAgent
from wbmpc.model import RobotModel, rolling_inverse_kinematics
from wbmpc.plant import SwerveCommand, scale_wheels

#: Speed [m/s] of a contact below which its wheel is not turned.
SLOW = 0.01
#: t [s] -> (base pose (3), its rate (3) in world axes), (leg angles (n), rates (n)).
Goals = Callable[[float], tuple[tuple[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]]


class RollingAgent(SwerveAgent):
    """``goals``: what base and legs shall do; gains [1/s] of base pose, legs and steering. The arm stands still.

    ``drive(t)`` gives the command of a tick. The other arguments are those of :class:`SwerveAgent`.
    """

    def __init__(
        self,
        robot: RobotModel,
        pose: np.ndarray,
        period: float,
        goals: Goals,
        base_gain: float = 1.5,
        leg_gain: float = 2.0,
        steer_gain: float = 8.0,
        **agent: Any,
    ) -> None:
        super().__init__(robot, pose, period, steer_gain=steer_gain, **agent)
        self.goals, self.base_gain, self.leg_gain = goals, base_gain, leg_gain

    def drive(self, t: float) -> SwerveCommand:
        """Drive speeds for this tick from the last measurement."""
        m, brake, geometry = self.measured, self.brakes(t), self.robot.base.geometry
        assert m is not None
        (pose, rate), (leg, leg_rate) = self.goals(t)
        error = pose - self.odometry.pose
        wanted = rate + self.base_gain * error
        c, s = np.cos(self.odometry.pose[2]), np.sin(self.odometry.pose[2])
        twist = np.array([c * wanted[0] + s * wanted[1], -s * wanted[0] + c * wanted[1], wanted[2]])
        swing = np.zeros(geometry.modules)
        if geometry.has_hinge:
            limit = self.robot.limits.input_upper[self.robot.input["leg"]]
            swing = brake * np.clip(leg_rate + self.leg_gain * (leg - m.leg), -limit, limit)
        target, wheel = rolling_inverse_kinematics(geometry, m.leg, m.steer, twist, swing)
        wheel, target = self._within(wheel, target, m.steer)
        # wheels that point elsewhere would drag the base along: slow down until they have turned
        wheel, _ = scale_wheels(wheel, float(self.robot.limits.input_upper[self.robot.input["wheel"]].min()))
        wheel = wheel * float(np.cos(np.minimum(np.abs(target - m.steer), 0.5 * np.pi)).min())
        steer_limit = self.robot.limits.input_upper[self.robot.input["steer"]]
        steer = np.clip(self.steer_gain * (target - m.steer), -steer_limit, steer_limit)
        if self.monitor is not None:
            self._watch(t, brake, swing)
        return SwerveCommand(wheel, steer, np.zeros(m.arm.size), brake)

    def _within(self, wheel: np.ndarray, target: np.ndarray, steer: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Slow wheels keep their angles; a heading beyond the joint's limit is that of the wheel turned about."""
        slow = np.abs(wheel) * self.robot.base.geometry.wheel_radius < SLOW
        target = np.where(slow, steer, target)
        part = self.robot.state["steer"]
        high = target > self.robot.limits.state_upper[part]
        low = target < self.robot.limits.state_lower[part]
        return np.where(high | low, -wheel, wheel), target - np.pi * high + np.pi * low
