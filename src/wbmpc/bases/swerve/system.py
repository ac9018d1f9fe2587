"""A simulated swerve robot with its controller and MPC: what views and first runs start from.

Wheels turn first: a guess for swerve bases with goals that are not known in advance.

At standstill the linearized rolling rows do not see the steering angles, so a base whose wheels point across its way would stay
where it is (see :mod:`wbmpc.bases.swerve.steering_planner`, which needs a preview of the motion: here it is the straight way to the goal).

Wheels turn first, for swerve bases that go along a path at their own speed: the motion that is foreseen is the path's.

At standstill the linearized rolling rows do not see the steering angles, and progress does not run away as a clock does: without a guess
a base whose wheels point across its path would wait for good.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from wbmpc.arrays import Array
from wbmpc.bases.base import Calibration
from wbmpc.bases.swerve.controller import SwerveController
from wbmpc.bases.swerve.defaults import StateCost, SwerveCost, swerve_mpc
from wbmpc.bases.swerve.estimator import EstimatorSettings
from wbmpc.bases.swerve.model import swerve_base
from wbmpc.bases.swerve.steering_planner import LEVER, SteeringGuess, speed, wheel_directions
from wbmpc.bases.swerve.tracking import TrackingSettings
from wbmpc.bases.swerve.wheel_calibration import WheelCalibration
from wbmpc.default_problem import stay_at_home
from wbmpc.model.robot import RobotModel
from wbmpc.mpc.mpc import MPC
from wbmpc.mpc.path import Following, PathProgress
from wbmpc.obstacles.world import Obstacles
from wbmpc.settings import ACTUATOR_TIME_CONSTANT, MpcSettings, StabilitySettings
from wbmpc.solver import Trajectory

if TYPE_CHECKING:
    from wbmpc.mpc.mpc import MPC

#: Way [m] over which the base's direction on the path is measured.
WAY = 1e-3
#: Points of the way ahead at which it is asked how fast wheels can follow it.
POINTS = 100
#: A guess goes through a kink of the path at this speed [m/s].
CREEP = 0.1


class PathGuess:
    """Callable for :class:`wbmpc.mpc.mpc.MPC` (``guess=``): the base goes as the path's references of the state (``along``) say."""

    def __init__(self, robot: RobotModel) -> None:
        self.robot, self._base = robot, robot.state["base"]
        self._guess = SteeringGuess(robot, self.preview)
        self._path: PathProgress | None = None

    def bind(self, mpc: MPC) -> None:
        """Whose path it is."""
        self._path = mpc.path
        self._guess.bind(mpc)

    def _following(self) -> Following | None:
        following = None if self._path is None else self._path.following
        return following if following is not None and "state" in following.along else None

    def __call__(self, t: float, x0: Array, trajectory: Trajectory) -> Trajectory | None:
        if self._following() is None:
            return None
        found = self._guess(t, x0, trajectory)
        if found is not None and self._path is not None:
            # progress where the base moves
            moving = speed(found.u[:, self.robot.input["base"]]) > 0.0
            way = self._path.desired(t, found.grid, self._most(t, found.grid[-1]))
            rate = np.append(np.diff(way), 0.0)
            self._path.write(found, np.concatenate([[0.0], np.cumsum(np.where(moving, rate[:-1], 0.0))]))
        return found

    def preview(self, times: Array, pose: Array) -> Array:
        """Body twists (n, 3) of the base at ``times`` (n) [s], of which the first is now."""
        following = self._following()
        assert following is not None and self._path is not None
        t, since, h = float(times[0]), times - times[0], 1e-2
        s, later = np.split(self._path.desired(t, np.append(since, since + h), self._most(t, since[-1] + h)), 2)
        return self._ways(following, s) * ((later - s) / h)[:, None]

    def _ways(self, following: Following, s: Array) -> Array:
        """Body twists (n, 3) of the base per meter of progress, at progress (n) [m]."""
        at, ahead = (following.along["state"](v)[:, self._base] for v in (s, s + WAY))
        way = (ahead - at) / WAY
        c, q = np.cos(at[:, 2]), np.sin(at[:, 2])
        return np.stack([c * way[:, 0] + q * way[:, 1], c * way[:, 1] - q * way[:, 0], way[:, 2]], axis=1)

    def _most(self, t: float, horizon: float) -> tuple[Array, Array]:
        """Progress (k) [m] that is in reach within a ``horizon`` [s], and how fast [m/s] wheels, their steering and the base can follow
        the path there and brake for what is ahead: a guess with wheels that are too fast takes many solves to mend, while the robot stands."""
        following, path = self._following(), self._path
        assert following is not None and path is not None
        ahead = path.desired(t, np.array([0.0, horizon]))
        s, limits, inputs = (
            np.linspace(ahead[0], ahead[1] + WAY, POINTS),
            self.robot.limits.input_upper,
            self.robot.input,
        )
        step, ways, geometry = s[1] - s[0], self._ways(following, s), swerve_base(self.robot).geometry
        legs = self.robot.home[self.robot.state["leg"]] if "leg" in self.robot.state else np.zeros(geometry.modules)
        angles, speeds = wheel_directions(geometry, legs, np.zeros(geometry.modules), ways)
        turns = np.abs(np.gradient(np.unwrap(angles, axis=0, period=np.pi), step, axis=0))
        fastest = limits[inputs["wheel"]] * geometry.wheel_radius
        shares = (speeds / fastest, turns / self._guess.rate, np.abs(ways) / limits[inputs["base"]])
        most = np.maximum(1.0 / np.maximum(np.concatenate(shares, axis=1).max(axis=1), 1e-9), CREEP)
        for k in range(POINTS - 2, -1, -1):
            most[k] = min(most[k], np.sqrt(most[k + 1] ** 2 + 2.0 * following.acceleration * step))
        return s, most


#: Speed [m/s] of the way that is foreseen, its least time [s]; a goal nearer than this [m] is reached.
SPEED, MINIMUM, THERE = 0.4, 1.0, 0.03


class GoalGuess:
    """Callable for :class:`wbmpc.mpc.mpc.MPC` (``guess=``): the base's goal is the present reference of the state."""

    def __init__(self, robot: RobotModel) -> None:
        self.robot, self._base = robot, robot.state["base"]
        self.goal = robot.home[self._base].copy()
        self._guess = SteeringGuess(robot, self.preview)
        self._mpc: MPC | None = None

    def bind(self, mpc: MPC) -> None:
        """Whose reference the goal is."""
        self._mpc = mpc
        self._guess.bind(mpc)

    def __call__(self, t: float, x0: Array, trajectory: Trajectory) -> Trajectory | None:
        assert self._mpc is not None, "the guess of an MPC"
        goal = self._mpc.reference["state"].at(t)[self._base]
        if _size(goal - self.goal) > THERE:
            self.goal, self._guess = goal.copy(), SteeringGuess(self.robot, self.preview)
            self._guess.bind(self._mpc)
        return self._guess(t, x0, trajectory)

    def preview(self, times: Array, pose: Array) -> Array:
        """Body twists (n, 3) of a straight way with a cosine's profile from ``pose`` (3) now to the goal."""
        way = self.goal - pose
        if _size(way) < THERE:
            return np.zeros((len(times), 3))
        length = max(0.5 * np.pi * _size(way) / SPEED, MINIMUM)
        share = np.clip((times - times[0]) / length, 0.0, 1.0)
        yaw = pose[2] + 0.5 * (1.0 - np.cos(np.pi * share)) * way[2]
        rate, c, s = 0.5 * np.pi / length * np.sin(np.pi * share), np.cos(yaw), np.sin(yaw)
        return rate[:, None] * np.stack([c * way[0] + s * way[1], c * way[1] - s * way[0], way[2] + 0.0 * c], axis=1)


def _size(way: Array) -> float:
    return float(np.hypot(way[0], way[1]) + LEVER * abs(way[2]))


#: Legs pull harder than in tracking: their configuration is asked for, not left over.
LEG_WEIGHT = 20.0


def make_mpc(
    robot: RobotModel, obstacles: Obstacles | None = None, stability: StabilitySettings | None = None, *,
    progress: str | None = None, **changes: Any,
) -> MPC:  # fmt: skip
    """The MPC whose goal is home; ``changes`` of its settings."""
    settings = MpcSettings(**{"horizon": 4.0, "intervals": 40, **changes})
    cost, guess = SwerveCost(state=StateCost(leg=LEG_WEIGHT)), PathGuess(robot) if progress else GoalGuess(robot)
    mpc = swerve_mpc(
        robot, settings, cost, guess, obstacles=obstacles, stability=stability, progress=progress, guarded=True
    )
    stay_at_home(robot, mpc)
    return mpc


def make_controller(
    robot: RobotModel, pose: Array, period: float, calibration: Calibration | None = None
) -> SwerveController:
    """Of a plant that stands at ``pose`` (3); ``calibration`` of its wheels (:class:`WheelCalibration`)."""
    wheels = None if calibration is None else WheelCalibration(**calibration)
    tracking, estimation = TrackingSettings(lag=ACTUATOR_TIME_CONSTANT), EstimatorSettings(calibration=wheels)
    return SwerveController(robot, pose, period, tracking=tracking, estimation=estimation)
