"""How far a base leans on soft casters, by its inertial unit, and what that does to its end effector.

Plans are of a level base. A lean moves the end effector by centimeters over a reach of a meter and a lean of half a degree; here the
arm's angles that a plan starts from are those with which a level base would have its end effector where it is. What an arm cannot make
up for, of few joints or stretched out, its base does: the plan starts from a base that stands so far aside.
"""

from __future__ import annotations

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from wbmpc.arrays import Array
from wbmpc.constants import GRAVITY
from wbmpc.model.robot import RobotModel

#: Doubt at the start of a lean [rad] and of a gyro's bias [rad/s]; walk of the bias [rad/s/√s] and of the lean [rad/√s]: the gyro's noise;
#: noise of what the accelerometer shows of the vertical [rad/√Hz]: also of motion that is not known, and of what commands say of it, for
#: each radian by which they tilt the vertical: drives lag and wheels slip for as long as a base speeds up or turns, not from sample to sample.
LEAN, BIAS, WALK, NOISE, VERTICAL, COMMANDED = 0.02, 0.05, 3e-5, 3e-4, 2e-3, 0.5
#: Time constant [s] of the lean that plans know of: arms that follow a base which rocks on its springs would rock it more.
SLOW = 1.0
#: How much [m] a radian of the end effector's direction counts; damping of the least squares [m/rad].
LEVER, DAMPING = 0.2, 0.02


class TiltFilter:
    """Kalman filters for the lean about the x and y axes of the base, each with the bias of its gyro.

    ``up`` (2): x and y, in axes of the base, of the unit vector that points up; 0 of a level base. Its rate is −ω × up; the accelerometer
    shows gravity along it, and its own acceleration at ``mount`` (3) [m] in axes of the base, which is subtracted as the drives make it of
    the commands.
    """

    def __init__(self, mount: ArrayLike = (0.0, 0.0, 0.0)) -> None:
        self._mount = np.asarray(mount, float).tolist()
        self._up, self._lean = (
            [0.0, 0.0],
            [0.0, 0.0],
        )  # numbers of Python: an array of two costs more than what is done with it
        self._bias = [0.0, 0.0]  # of ω_y and −ω_x: what turns up[0] back, and up[1]
        self._variances = LEAN**2, 0.0, BIAS**2  # of lean, of both, of bias: the same of both filters
        self._twist: tuple[float, float, float] | None = None

    @property
    def up(self) -> Array:
        """See the class."""
        return np.array(self._up)

    @property
    def turned(self) -> Array:
        """Rotation vector (3) [rad] from the level base to the tilted one, in axes of the base, without its rocking."""
        return np.array([self._lean[1], -self._lean[0], 0.0])

    def update(self, h: float, gyro: ArrayLike, accel: ArrayLike, twist: ArrayLike) -> None:
        """After h [s] with the inertial unit's ``gyro`` (3) [rad/s] and ``accel`` (3) [m/s²] and the base's ``twist`` (vx, vy, ω) in its own
        axes."""
        (turn_x, turn_y, turn_z), (accel_x, accel_y, _) = np.asarray(gyro).tolist(), np.asarray(accel).tolist()
        vx, vy, turning = np.asarray(twist).tolist()
        last, self._twist = self._twist, (vx, vy, turning)
        if h <= 0.0 or last is None:
            return
        ahead, aside, _ = self._mount
        change = (turning - last[2]) / h
        own = (
            (vx - last[0]) / h - turning * (vy + turning * ahead) - change * aside,
            (vy - last[1]) / h + turning * (vx - turning * aside) + change * ahead,
        )
        gain, bias_gain = self._gains(h, VERTICAL**2 + (COMMANDED / GRAVITY) ** 2 * (own[0] ** 2 + own[1] ** 2))
        (x, y), slow = self._up, min(h / SLOW, 1.0)
        rates = turn_z * y - turn_y, turn_x - turn_z * x
        for k, (rate, shown) in enumerate(zip(rates, (accel_x - own[0], accel_y - own[1]), strict=True)):
            up = self._up[k] + h * (rate + self._bias[k])
            off = shown / GRAVITY - up
            self._up[k], self._bias[k] = up + gain * off, self._bias[k] + bias_gain * off
            self._lean[k] += slow * (self._up[k] - self._lean[k])

    def _gains(self, h: float, noise: float) -> tuple[float, float]:
        """Of lean and bias, after their variances have grown for h [s] and shrunk by what comes now, with a ``noise`` [rad²/Hz]."""
        lean, both, bias = self._variances
        lean, both = lean + h * (2.0 * both + h * bias + NOISE**2), both + h * bias
        bias += h * WALK**2
        whole = lean + noise / h
        self._variances = lean - lean * lean / whole, both - lean * both / whole, bias - both * both / whole
        return lean / whole, both / whole


class LevelArm:
    """The arm of a robot as a level base would need it, for the end effector of one that leans; the base where the arm does not reach."""

    def __init__(self, robot: RobotModel) -> None:
        x, u = ca.SX.sym("x", robot.state.size), ca.SX.sym("u", robot.input.size)
        linear, angular = robot.frame_velocity(x, u, robot.tool)
        arm = robot.input["arm"]
        rows = ca.jacobian(ca.vertcat(linear, LEVER * angular), u)[:, arm]
        self._seen = ca.Function("arm", [x], [robot.frame_pose(x, robot.tool).position, rows])
        self._height, self._arm = robot.base.body_height, robot.state["arm"]

    def __call__(self, x: Array, turned: Array) -> Array:
        """The state (nx) with the arm moved, least squares, and the base on the floor by the rest; ``turned`` (3) [rad]: the lean in axes of
        the base, about the point on the floor under its frame."""
        position, rows = (np.asarray(part) for part in self._seen(x))
        c, s = np.cos(x[2]), np.sin(x[2])
        lean = np.array([c * turned[0] - s * turned[1], s * turned[0] + c * turned[1], 0.0])
        arm = position.ravel() - [x[0], x[1], 0.0]
        target = np.concatenate([np.cross(lean, arm), LEVER * lean])
        moved = rows.T @ np.linalg.solve(rows @ rows.T + DAMPING**2 * np.eye(6), target)
        found: Array = x.copy()
        found[self._arm] += moved
        found[:2] += (target - rows @ moved)[:2]
        return found
