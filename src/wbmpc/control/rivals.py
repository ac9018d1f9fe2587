"""Controllers of swerve bases without an MPC, to compare with: same odometry, same drives, same limits.

They follow a reference pose and twist by feed-forward and proportional feedback. Their gains were found by a search on the
tuning seeds (``benchmarks/rivals.py``).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from wbmpc.control.swerve import SwerveAgent
from wbmpc.model import RobotModel, rolling_inverse_kinematics
from wbmpc.mpc import Plans
from wbmpc.plant import SwerveCommand

#: (time [s]) -> (pose (3), body twist (3)) of the reference.
Wanted = Callable[[float], tuple[np.ndarray, np.ndarray]]
#: Speed [m/s] below which a reference counts as rest: the wheels then turn to the motion that comes.
REST = 0.01


class InverseKinematicsAgent(SwerveAgent):
    """Rolling inverse kinematics: a body twist from the pose error, then a steering angle and a speed for every wheel.

    ``gain`` [1/s] of the pose error; ``lead`` [s] by which the reference is read ahead (drives lag); ``look_ahead`` [s]: a
    base at rest turns its wheels to the motion that will begin so soon; ``steer_gain`` [1/s]. Wheels slow down together
    while one of them does not point where it should.
    """

    def __init__(
        self,
        robot: RobotModel,
        pose: np.ndarray,
        period: float,
        wanted: Wanted,
        *,
        gain: float = 2.0,
        lead: float = 0.04,
        look_ahead: float = 1.0,
        steer_gain: float = 10.0,
        **estimation: Any,
    ) -> None:
        super().__init__(robot, pose, period, steer_gain=steer_gain, **estimation)
        self.reference, self.gain, self.lead, self.look_ahead = wanted, gain, lead, look_ahead

    def twist(self, pose: np.ndarray, twist: np.ndarray) -> np.ndarray:
        """Body twist (3) from the reference's pose and twist, and the estimated pose."""
        error = self._error(pose)
        c, s = np.cos(error[2]), np.sin(error[2])
        ahead = np.array([c * twist[0] - s * twist[1], s * twist[0] + c * twist[1], twist[2]])
        return ahead + self.gain * error

    def _error(self, pose: np.ndarray) -> np.ndarray:
        """Of the pose (3), in the base's axes."""
        own = self.odometry.pose
        c, s = np.cos(own[2]), np.sin(own[2])
        dx, dy = pose[:2] - own[:2]
        return np.array([c * dx + s * dy, -s * dx + c * dy, pose[2] - own[2]])

    def command(self, t: float, plans: Plans) -> SwerveCommand:
        """Drive speeds for this tick; the arm stands still."""
        m, geometry = self.measured, self.robot.base.geometry
        assert m is not None
        leg = m.leg if m.leg.size else np.zeros(geometry.modules)
        pose, twist = self.reference(t + self.lead)
        asked = self.twist(pose, twist)
        resting = np.abs(twist).max() < REST
        aim = asked
        if resting:
            soon = self.reference(t + self.look_ahead)[1]
            aim = soon if np.abs(soon).max() >= REST else np.zeros(3)
        target, _ = rolling_inverse_kinematics(geometry, leg, m.steer, aim)
        target = self._within(target, m.steer)
        _, speed = rolling_inverse_kinematics(geometry, leg, target, np.zeros(3) if resting else asked)
        aligned = max(0.0, float(np.cos(target - m.steer).min()))
        limits, given = self.robot.limits.input_upper, self.robot.input
        steer = np.clip(self.steer_gain * (target - m.steer), -limits[given["steer"]], limits[given["steer"]])
        wheel = aligned * speed
        wheel = wheel / max(1.0, float(np.max(np.abs(wheel) / limits[given["wheel"]])))
        return SwerveCommand(wheel, steer, np.zeros(len(given.groups["arm"])), self.brakes(t))

    def _within(self, target: np.ndarray, steer: np.ndarray) -> np.ndarray:
        """Steering targets turned by half a turn where they leave the joint's range."""
        index = self.robot.state["steer"]
        low, high = self.robot.limits.state_lower[index], self.robot.limits.state_upper[index]
        return np.where(target > high, target - np.pi, np.where(target < low, target + np.pi, target))


class FourWheelSteeringAgent(InverseKinematicsAgent):
    """The classic four-wheel-steering base: forward speed and yaw rate only, no sideways motion.

    Tracking law of Kanayama et al. (ICRA 1990): v = v_r cos e_θ + k_x e_x, ω = ω_r + |v_r| (k_y e_y + k_θ sin e_θ).
    """

    def twist(self, pose: np.ndarray, twist: np.ndarray) -> np.ndarray:
        """Body twist (3) whose sideways part is 0."""
        ex, ey, yaw = self._error(pose)
        speed = float(twist[0])
        turn = twist[2] + self.gain * (speed * self.gain * ey + max(abs(speed), 0.2) * np.sin(yaw))
        return np.array([speed * np.cos(yaw) + self.gain * ex, 0.0, turn])
