"""Missions of the reconfigurable base: where base and legs shall be over time, and when brakes open and close."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from wbmpc import lie
from wbmpc.control import BrakeControl
from wbmpc.experiments.paths import _ramp as _ramped
from wbmpc.experiments.paths import _rise
from wbmpc.model import RobotModel
from wbmpc.mpc import MPC
from wbmpc.ocp import Reference


@dataclass(frozen=True)
class Leg:
    """One part of the way: from ``start`` [s] within ``length`` [s] from the goal before to ``goal`` (x, y, yaw) in the world.

    At constant speed but for ``ramp`` [s] at its ends. Parts may overlap in time; their motions add up.
    """

    start: float
    length: float
    goal: tuple[float, float, float]
    ramp: float = 1.5

    def share(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """How much of the part is done at times t (k,) [s], and its rate [1/s]."""
        s, ramp = t - self.start, min(self.ramp, 0.5 * self.length)
        late, full = s - (self.length - ramp), self.length - ramp
        return (_ramped(s, ramp) - _ramped(late, ramp)) / full, (_rise(s, ramp) - _rise(late, ramp)) / full


@dataclass(frozen=True)
class Reconfiguration:
    """From ``start`` [s] the legs turn to ``angles`` (n) [rad] by ramps of ``rate`` [rad/s]."""

    start: float
    angles: np.ndarray
    rate: float = 0.2


@dataclass(frozen=True)
class Mission:
    """Base poses (from the origin), leg angles from ``legs``, brake events.

    ``brakes``: (time [s], open (0 or 1) for all legs); closed before the first.
    """

    way: tuple[Leg, ...]
    legs: np.ndarray
    reconfigurations: tuple[Reconfiguration, ...] = ()
    brakes: tuple[tuple[float, float], ...] = ()

    def base(self, t: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
        """Poses (k, 3) and their rates (k, 3) in world axes at times t (k,)."""
        t = np.atleast_1d(np.asarray(t, float))
        pose, rate, last = np.zeros((t.size, 3)), np.zeros((t.size, 3)), np.zeros(3)
        for part in self.way:
            goal = np.array(part.goal)
            done, speed = part.share(t)
            pose += done[:, None] * (goal - last)
            rate += speed[:, None] * (goal - last)
            last = goal
        return pose, rate

    def twist(self, t: ArrayLike) -> np.ndarray:
        """Body twists (k, 3) of the base's reference."""
        pose, rate = self.base(t)
        c, s = np.cos(pose[:, 2]), np.sin(pose[:, 2])
        return np.stack([c * rate[:, 0] + s * rate[:, 1], -s * rate[:, 0] + c * rate[:, 1], rate[:, 2]], axis=1)

    def leg(self, t: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
        """Leg angles (k, n) and rates (k, n)."""
        t = np.atleast_1d(np.asarray(t, float))
        angle, rate = np.tile(self.legs, (t.size, 1)), np.zeros((t.size, self.legs.size))
        at = np.array(self.legs, float)
        for part in self.reconfigurations:
            way = part.angles - at
            gone = np.clip(part.rate * (t - part.start), 0.0, None)[:, None]
            angle += np.sign(way) * np.minimum(gone, np.abs(way))
            rate += np.where((gone > 0.0) & (gone < np.abs(way)), part.rate * np.sign(way), 0.0)
            at = np.array(part.angles, float)
        return angle, rate

    def preview(self, t: np.ndarray, pose: np.ndarray) -> np.ndarray:
        """Body twists (k, 3) that the steering guess looks at."""
        return self.twist(t)

    def apply(self, brakes: BrakeControl) -> None:
        """Schedule the brake events."""
        for t, is_open in self.brakes:
            brakes.set(t, np.full(self.legs.size, is_open))

    def set(self, mpc: MPC, robot: RobotModel, home: np.ndarray, duration: float) -> None:
        """References of base, legs and twist; the arm's posture is that of ``home``."""
        t = np.arange(0.0, duration + 0.02, 0.02)
        states, inputs = np.tile(home, (t.size, 1)), np.zeros((t.size, robot.input.size))
        states[:, robot.state["base"]] = self.base(t)[0]
        states[:, robot.state["leg"]], inputs[:, robot.input["leg"]] = self.leg(t)
        inputs[:, robot.input["base"]] = self.twist(t)
        mpc.reference["state"], mpc.reference["input"] = Reference(t, states), Reference(t, inputs)


def riding(robot: RobotModel, home: np.ndarray, poses: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Positions (k, 3) and quaternions (k, 4) of a hand that rides along with base poses (k, 3) as it is at ``home``."""
    place, orientation = robot.pose(home)
    turns = np.array([lie.quaternion_multiply(lie.quaternion_about((0, 0, 1), p[2]), orientation) for p in poses])
    points = np.array([[*lie.se2_compose(p, [place[0], place[1], 0.0])[:2], place[2]] for p in poses])
    return points, turns
