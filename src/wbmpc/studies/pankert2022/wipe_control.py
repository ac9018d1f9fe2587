"""How a swerve robot presses on a wall whose place it does not know: touch, press, wipe, retreat.

The normal direction is controlled by force through an estimate of the wall. Where the tip touches, its place less what its spring gives
way (the force over a nominal stiffness) is a place of the wall, whatever the robot does. A Kalman filter makes a line of these places,
and the reference of the end effector is that line, beyond it by as much as the wanted force presses the spring in. What is left of the
force's error is integrated. The MPC, which moves base and arm along the wall by the same reference, is the usual one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wbmpc import lie
from wbmpc.arrays import Array
from wbmpc.bases.swerve.controller import SwerveController
from wbmpc.bases.swerve.messages import SwerveMeasurement
from wbmpc.constants import GRAVITY
from wbmpc.errors import RunAborted
from wbmpc.model.robot import RobotModel
from wbmpc.mpc.mpc import MPC
from wbmpc.mpc.policy_queue import PolicyQueue
from wbmpc.ocp import Reference
from wbmpc.studies.pankert2022.track_references import END_EFFECTOR_ORIENTATION
from wbmpc.studies.pankert2022.wipe_messages import WipeMeasurement
from wbmpc.studies.paths import Approach
from wbmpc.tasks.paths import rise, risen
from wbmpc.types import Observation

#: The way on the wall: where it begins along it, its height and the wall's place across, as far as it is known [m].
BEGIN, HEIGHT, WALL = -0.20, 0.90, 0.85
#: Share of the end effector's way along the wall that the base makes.
BASE_SHARE = 0.85
#: Distance [m] from where the wall should be at which the touch begins; the tip is looked for something so far beyond [m].
STANDOFF, DEEPEST = 0.06, 0.06
#: It touches from this force on, and stops at this multiple of the wanted one [N].
TOUCHES, TOO_MUCH = 3.0, 4.0
#: Times [s]: of the force's rise, of standing with it before and after the way, of the rise of the speed, of the retreat and its length [m].
RISE, STAND, RAMP, RETREAT, BACK = 1.0, 0.5, 1.0, 1.5, 0.06
#: Of the wall's line: standard deviation of a place [m], and of place [m] and slope at first; how fast they may change [m/√s, 1/√s].
PLACE_NOISE, FIRST, CHANGE = 2e-4, (0.02, 0.02), (1e-3, 1e-3)
#: Gain [1/s] of the force's integral, and the most that it adds [N].
INTEGRAL, MAX_EXTRA = 0.5, 4.0
#: Knots [s] of a reference over the horizon: fine at first.
FINE, COARSE, NEAR = 0.02, 0.1, 0.6


class WallLine:
    """A Kalman filter of the wall: ``place`` [m] across at ``along`` [m], and ``slope`` by which it changes along it."""

    def __init__(self) -> None:
        self.along = 0.0
        self._x, self._p = np.zeros(2), np.diag(np.square(FIRST))

    @property
    def slope(self) -> float:
        return float(self._x[1])

    def begin(self, along: float, place: float) -> None:
        """The first place that is touched."""
        self.along, self._x[0] = along, place
        self._p[0, 0] = PLACE_NOISE**2

    def update(self, h: float, along: float, place: float) -> None:
        """Another ``place`` [m] of the wall, at ``along`` [m], h [s] later."""
        move = np.array([[1.0, along - self.along], [0.0, 1.0]])
        self.along = along
        x, p = move @ self._x, move @ self._p @ move.T + h * np.diag(np.square(CHANGE))
        gain = p[:, 0] / (p[0, 0] + PLACE_NOISE**2)
        self._x, self._p = x + gain * (place - x[0]), p - np.outer(gain, p[0])

    def at(self, along: Array) -> Array:
        """Places (n,) [m]."""
        return np.asarray(self._x[0] + self._x[1] * (along - self.along))


@dataclass(frozen=True)
class Order:
    """What is wanted: ``force`` [N] along the normal, ``length`` [m] of the way and ``speed`` [m/s] along it, ``touch_speed`` [m/s] towards
    the wall; ``stiffness`` [N/m] of the spring as far as it is known; ``radius`` [m] and ``mass`` [kg] of the tip."""

    force: float
    length: float
    speed: float
    touch_speed: float
    stiffness: float
    radius: float
    mass: float


class Wipe:
    """The order over time. ``touched`` [s]: since when; ``began`` and ``ended``: when the force is there, and the way's end; infinite before."""

    def __init__(self, robot: RobotModel, order: Order, height: float = HEIGHT) -> None:
        self.robot, self.order = robot, order
        self.first = np.array([BEGIN, WALL - STANDOFF - order.radius, height])
        self.approach = Approach(robot.pose(robot.home), (self.first, END_EFFECTOR_ORIENTATION))
        self.search = self.approach.duration + 0.5
        self.line, self.touched, self.extra = WallLine(), np.inf, 0.0
        self.coefficient = np.nan
        self._updated = 0.0

    @property
    def began(self) -> float:
        return self.touched + RISE

    @property
    def ended(self) -> float:
        return self.began + STAND + self.order.length / self.order.speed + RAMP

    @property
    def released(self) -> float:
        """When [s] it retreats: plans see it before."""
        return self.ended + STAND

    @property
    def done(self) -> float:
        return self.released + RETREAT + 0.5

    @property
    def longest(self) -> float:
        """The most [s] that it may take."""
        late = (STANDOFF + DEEPEST) / self.order.touch_speed
        return self.search + late + RISE + 2.0 * STAND + self.order.length / self.order.speed + RAMP + RETREAT + 1.0

    def force(self, t: Array) -> Array:
        """What is ordered (n,) [N]: rises after the touch, none from the release on."""
        rising = TOUCHES + (self.order.force - TOUCHES) * rise(t - self.touched, RISE)
        return np.where((t >= self.touched) & (t < self.released), rising, 0.0)

    def way(self, t: Array) -> Array:
        """How far (n,) [m] along the wall."""
        since = t - self.began - STAND
        late = since - self.order.length / self.order.speed
        return np.asarray(self.order.speed * (risen(since, RAMP) - risen(late, RAMP)))

    @property
    def touches(self) -> bool:
        return bool(np.isfinite(self.touched))

    def update(self, t: float, x: Array, force: Array) -> None:
        """With the estimated state x (nx) and the sensor's force (3) [N] at t [s]."""
        place, quaternion = self.robot.pose(x)
        pressed = lie.quaternion_to_rotation(quaternion) @ force + [0.0, 0.0, self.order.mass * GRAVITY]
        normal = np.array([-self.line.slope, 1.0, 0.0]) / np.hypot(self.line.slope, 1.0)
        push = float(pressed @ normal)
        if push > TOO_MUCH * self.order.force:
            raise RunAborted(f"the end effector presses with {push:.0f} N")
        surface = place[1] + self.order.radius - push / self.order.stiffness
        if not self.touches:
            if t >= self.search and push >= TOUCHES:
                self.touched = t
                self.line.begin(place[0], surface)
            elif place[1] + self.order.radius > WALL + DEEPEST - 0.005:
                raise RunAborted(f"the end effector finds no wall up to {1e3 * DEEPEST:.0f} mm behind its place")
        elif t < self.released:
            h = t - self._updated
            self.line.update(h, place[0], surface)
            error = float(self.force(np.array([t]))[0]) - push
            self.extra = float(np.clip(self.extra + INTEGRAL * h * error, -MAX_EXTRA, MAX_EXTRA))
            if push > TOUCHES:
                self.coefficient = float(np.linalg.norm(pressed - push * normal) / push)
        self._updated = t

    def end_effector(self, t: Array) -> Array:
        """Positions (n, 3) [m] in the estimated frame."""
        place = np.tile(self.first, (t.size, 1))
        place[:, 0] += self.way(t)
        if not self.touches:
            ahead = self.order.touch_speed * np.maximum(t - self.search, 0.0)
            place[:, 1] += np.minimum(ahead, STANDOFF + DEEPEST)
            return place + self.approach.offset(t)[0]
        pressed = (self.force(t) + np.where(t < self.released, self.extra, 0.0)) / self.order.stiffness
        place[:, 1] = self.line.at(place[:, 0]) - self.order.radius + pressed - BACK * rise(t - self.released, RETREAT)
        return place

    def set(self, mpc: MPC, t: float) -> None:
        """The references of the MPC from t [s] on."""
        horizon = mpc.ocp.horizon + COARSE
        times = t + np.concatenate([np.arange(0.0, NEAR, FINE), np.arange(NEAR, horizon, COARSE)])
        robot, along = self.robot, BASE_SHARE * self.way(times)
        turns = self.approach.offset(times)[1]
        mpc.reference["end_effector"] = Reference.poses(times, self.end_effector(times), turns)
        states = np.tile(robot.home, (times.size, 1))
        states[:, robot.state["base"].start] = along
        mpc.reference["state"] = Reference(times, states)
        inputs = np.zeros((times.size, robot.input.size))
        inputs[:, robot.input["base"].start] = np.gradient(along, times)
        mpc.reference["input"] = Reference(times, inputs)


class WipeController(SwerveController):
    """A swerve robot's controller that sets the references of ``mpc`` by what a ``wipe`` makes of the force."""

    wipe: Wipe
    mpc: MPC

    def predict(self, t: float, until: float, plans: PolicyQueue) -> Observation:
        """Before a plan: the wall as it is known now."""
        m: SwerveMeasurement | None = self.measured
        assert isinstance(m, WipeMeasurement)
        self.wipe.update(t, self.state(), m.force)
        self.wipe.set(self.mpc, t)
        return super().predict(t, until, plans)
