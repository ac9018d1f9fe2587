"""From policies to drive commands of a swerve robot, and from encoders to observations.

The MPC's state holds the *planned* steering angles; a servo closes their difference to the measured ones. (With measured
angles the rolling rows of four wheels are never exactly consistent, and their only exact solution is standstill.)
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from wbmpc import lie
from wbmpc.estimation import WheelOdometry
from wbmpc.model import RobotModel
from wbmpc.mpc import Observation, Plans
from wbmpc.plant import SwerveCommand, SwerveMeasurement


class SwerveAgent:
    """Estimation, prediction and tracking of a swerve robot at the controller's rate.

    ``period`` [s] of the controller; ``brakes(t)``: brake state (n) at a time, 1 = open; ``steer_gain`` [1/s];
    ``lag`` [s] of the drives, first order: the plan leads the measured state by it;
    ``gyro_share``: how much of the odometry's yaw comes from the gyro (its bias averaged at rest); the rest from the wheels.
    ``clamped``: whether the wheels of the last command were slowed down to their limits.
    """

    def __init__(
        self,
        robot: RobotModel,
        pose: np.ndarray,
        period: float,
        brakes: Callable[[float], np.ndarray] | None = None,
        steer_gain: float = 5.0,
        planned_steering: bool = True,
        gyro_share: float = 0.0,
        lag: float = 0.0,
    ) -> None:
        self.robot, self.period, self.steer_gain = robot, period, steer_gain
        self.planned_steering = planned_steering
        self.odometry = WheelOdometry(robot.base.geometry, pose)
        self.wheels_alone = WheelOdometry(robot.base.geometry, pose)
        self.gyro_share, self.gyro_bias = gyro_share, 0.0
        self._rest: list[float] = []
        self.lag = lag
        self._blend = 1.0 - np.exp(-period / lag) if lag > 0.0 else 1.0
        self._rates = np.zeros(robot.input.size)
        hinges = len(robot.state.groups.get("leg", ()))
        self.brakes = brakes or (lambda t: np.zeros(hinges))
        self.measured: SwerveMeasurement | None = None
        self.clamped = False
        self.wanted = np.zeros(robot.input.size)  # what plan and steering servo ask for, before it is scaled

    def measure(self, measurement: SwerveMeasurement) -> None:
        """Take in the encoders of this tick."""
        self.measured = measurement
        encoders = (measurement.leg, measurement.steer, measurement.wheel)
        self.wheels_alone.update(*encoders)
        turn = (float(measurement.gyro[2]) - self.gyro_bias) * self.period
        own = float(self.wheels_alone.increment[2])
        self.odometry.update(*encoders, self.gyro_share * turn + (1.0 - self.gyro_share) * own)

    def base_pose(self) -> np.ndarray:
        """Estimated pose (7) of the base in the frame of the odometry: position [m] at the nominal height, quaternion."""
        x, y, yaw = self.odometry.pose
        return np.array([x, y, self.robot.base.height, *lie.quaternion_about((0.0, 0.0, 1.0), yaw)])

    def rest(self, measurement: SwerveMeasurement) -> None:
        """Take in a message while the robot stands: the gyro's bias is the mean of what it reads then."""
        self._rest.append(float(measurement.gyro[2]))
        self.gyro_bias = float(np.mean(self._rest))

    def state(self) -> np.ndarray:
        """Estimated state (nx), with the measured steering angles."""
        m = self.measured
        assert m is not None
        parts = {"base": self.odometry.pose, "leg": m.leg, "steer": m.steer, "wheel": m.wheel, "arm": m.arm}
        return self.robot.state.vector({g: parts[g] for g in self.robot.state.groups})

    def predict(self, t: float, until: float, plans: Plans) -> Observation:
        """The state at time ``until``, by the inputs that will be applied from ``t`` on, and what the drives still owe.

        The plan's clock runs ahead of the wall's by the lag: what is commanded now acts that much later.
        """
        state = self.robot.state
        x = self.state()
        if plans.current is not None and self.planned_steering:
            x[state["steer"]] = plans.current.state(t + self.lag)[state["steer"]]
        # A first-order drive still moves by lag times its present rate after the last command: the state leads by that.
        self._move(x, self._rates, self.lag, self.brakes(t))
        for k in range(round((until - t) / self.period)):
            now = t + (k + 0.5) * self.period
            policy = plans.at(now)
            if policy is None:
                break
            u = policy.feedforward(now + self.lag)
            self._move(x, u, self.period, self.brakes(now))
        return Observation(until + self.lag, x)

    def _move(self, x: np.ndarray, u: np.ndarray, h: float, brake: np.ndarray) -> None:
        """Integrate input rates u over h [s] into the state x, in place; the planned steering has no lag."""
        state, given = self.robot.state, self.robot.input
        x[state["base"]] = lie.se2_step(x[state["base"]], u[given["base"]] * h)
        for group in ("leg", "steer", "wheel", "arm"):
            if group in state:
                x[state[group]] += u[given[group]] * (brake * h if group == "leg" else h)

    def stop(self) -> SwerveCommand:
        """Everything at rest, brakes closed."""
        return SwerveCommand.stop(self.robot.base.geometry.modules, len(self.robot.input.groups["arm"]))

    def command(self, t: float, plans: Plans) -> SwerveCommand:
        """Drive speeds for this tick; a stop once the plan has run out.

        The plan's inputs and a steering servo: the gains of the policy are not used, since drives that follow speeds hold
        a kinematic plan without them, and feedback on wheels from an estimated pose would break the rolling rows.
        """
        policy, m, given = plans.current, self.measured, self.robot.input
        assert policy is not None and m is not None
        if t > policy.end:
            return self.stop()
        u = policy.feedforward(t + self.lag)
        planned = policy.state(t + self.lag)[self.robot.state["steer"]]
        self._rates += self._blend * (u - self._rates)
        if self.planned_steering:
            self._rates[given["steer"]] = 0.0
        steer = u[given["steer"]] + self.steer_gain * (planned - m.steer)
        self.wanted = u
        self.wanted[given["steer"]] = steer
        wheel, limit = u[given["wheel"]], self.robot.limits.input_upper[given["wheel"]]
        # Too fast for one wheel: slow the whole motion down, or the wheels drag each other.
        excess = float(np.max(np.abs(wheel) / limit))
        self.clamped, wheel = excess > 1.0, wheel / max(1.0, excess)
        return SwerveCommand(wheel, steer, u[given["arm"]], self.brakes(t))
