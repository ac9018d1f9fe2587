"""Missions of the reconfigurable base: where base and legs shall be over time, and when brakes open and close."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from wbmpc import lie
from wbmpc.bases.swerve.brake_control import FLOATING, FLOATING_TIME, BrakeControl, described, floating
from wbmpc.bases.swerve.model import swerve_base
from wbmpc.errors import InputError
from wbmpc.model.robot import RobotModel
from wbmpc.model.wheels import ModuleGeometry, wheel_velocities
from wbmpc.mpc.mpc import MPC
from wbmpc.ocp import Reference
from wbmpc.studies.pankert2022.directions import reject_directions
from wbmpc.tasks.paths import rise, risen

#: Speed [m/s] below which a wheel stands; weight of a sample close to a limit against a turn by one radian.
STANDS, TURN_SHARE = 0.01, 0.02
#: Angle [rad] beyond the way of a wheel that never turns round at which its range is not checked any more.
WINDING = 4.0 * np.pi


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
        return (risen(s, ramp) - risen(late, ramp)) / full, (rise(s, ramp) - rise(late, ramp)) / full


@dataclass(frozen=True)
class Reconfiguration:
    """From ``start`` [s] the legs, or the arm's joints, go to ``angles`` (n) [rad, or m of those that slide] by ramps of ``rate`` [per s]."""

    start: float
    angles: np.ndarray
    rate: float = 0.2


def ramps(first: np.ndarray, parts: Sequence[Reconfiguration], t: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
    """Angles (k, n) and rates (k, n) at times t (k,), beginning at ``first`` (n)."""
    t = np.atleast_1d(np.asarray(t, float))
    angle, rate = np.tile(first, (t.size, 1)), np.zeros((t.size, first.size))
    at = np.array(first, float)
    for part in parts:
        way = part.angles - at
        gone = np.clip(part.rate * (t - part.start), 0.0, None)[:, None]
        angle += np.sign(way) * np.minimum(gone, np.abs(way))
        rate += np.where((gone > 0.0) & (gone < np.abs(way)), part.rate * np.sign(way), 0.0)
        at = np.array(part.angles, float)
    return angle, rate


@dataclass(frozen=True)
class Mission:
    """Base poses (from the origin), leg angles from ``legs``, brake events, and postures of the arm (``arm``), which begins at home.

    ``brakes``: (time [s], open (0 or 1) for all legs); closed before the first.
    """

    way: tuple[Leg, ...]
    legs: np.ndarray
    reconfigurations: tuple[Reconfiguration, ...] = ()
    brakes: tuple[tuple[float, float], ...] = ()
    arm: tuple[Reconfiguration, ...] = ()

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
        return ramps(self.legs, self.reconfigurations, t)

    def steer(self, robot: RobotModel, t: ArrayLike) -> np.ndarray:
        """Steering angles (k, n) [rad] that roll the references at times t (k,), within the joints' limits.

        A wheel and the wheel turned about roll alike; which one it is to be when is chosen for the whole mission. Raises
        :class:`InputError` for a direction that is out of a range either way.
        """
        t = np.atleast_1d(np.asarray(t, float))
        g, twist = swerve_base(robot).geometry, self.twist(t)
        leg, rate = self.leg(t)
        reject_directions(robot, t, twist, leg, rate)
        velocity = np.array([wheel_velocities(g, a, v, r) for a, v, r in zip(leg, twist, rate, strict=True)])
        speed = np.hypot(velocity[..., 0], velocity[..., 1])
        angle = np.arctan2(velocity[..., 1], velocity[..., 0]) - g.wheel_heading - leg * (1.0 - g.slides)
        part = robot.state["steer"]
        low, high = robot.limits.state_lower[part], robot.limits.state_upper[part]
        columns = [branches(angle[:, i], speed[:, i], low[i], high[i]) for i in range(g.modules)]
        return np.stack(columns, axis=1)

    def preview(self, t: np.ndarray, pose: np.ndarray) -> np.ndarray:
        """Body twists (k, 3) that the steering guess takes."""
        return self.twist(t)

    def check(self, geometry: ModuleGeometry) -> None:
        """Open legs that are all parallel hold nothing sideways: they may be passed, not be stayed in (:class:`InputError`)."""
        if not self.brakes:
            return
        ends = [p.start + float(np.abs(p.angles).max() + np.pi) / p.rate for p in self.reconfigurations]
        t = np.arange(self.brakes[0][0], max([*ends, self.brakes[-1][0]]) + 2.0 * FLOATING_TIME, 0.05)
        times, states = (np.array(c) for c in zip(*self.brakes, strict=True))
        is_open = states[np.searchsorted(times, t + 1e-9) - 1] > 0.5
        since = np.inf
        for now, flag, leg in zip(t, is_open, self.leg(t)[0], strict=True):
            held, motion = floating(geometry, leg, np.full(leg.size, float(flag)))
            since = min(since, now) if held < FLOATING else np.inf
            if now - since > FLOATING_TIME:
                raise InputError(
                    f"mission: from {since:.2f} s on the brakes are open while the legs hold nothing against "
                    f"{described(motion)}, for more than {FLOATING_TIME:g} s; valid: closed brakes, or legs that move on"
                )

    def apply(self, brakes: BrakeControl) -> None:
        """Schedule the brake events, after :meth:`check`; brakes wait for legs that the mission moves."""
        self.check(brakes.geometry)
        if self.reconfigurations:
            brakes.arrivals = lambda t: self.leg(t)[0][0]
        for t, is_open in self.brakes:
            brakes.set(t, np.full(self.legs.size, is_open))

    def set(self, mpc: MPC, robot: RobotModel, home: np.ndarray, duration: float) -> None:
        """References of base, legs, twist and arm, whose first posture is that of ``home``."""
        t = np.arange(0.0, duration + 0.02, 0.02)
        states, inputs = np.tile(home, (t.size, 1)), np.zeros((t.size, robot.input.size))
        states[:, robot.state["base"]] = self.base(t)[0]
        states[:, robot.state["steer"]] = self.steer(robot, t)
        states[:, robot.state["leg"]], inputs[:, robot.input["leg"]] = self.leg(t)
        inputs[:, robot.input["base"]] = self.twist(t)
        part = robot.state["arm"]
        states[:, part], inputs[:, robot.input["arm"]] = ramps(home[part], self.arm, t)
        mpc.reference["state"], mpc.reference["input"] = Reference(t, states), Reference(t, inputs)


def at_home(robot: RobotModel, legs: np.ndarray) -> np.ndarray:
    """The robot's home with its legs at ``legs`` (n) [rad, or m of those that slide], the wheels along the same directions of the body."""
    home, leg, part = robot.home.copy(), robot.state["leg"], robot.state["steer"]
    steer = home[part] + swerve_base(robot).geometry.leg_angles(home[leg] - legs)
    low, high = robot.limits.state_lower[part], robot.limits.state_upper[part]
    # a wheel rolls alike the other way round, which may be within its range
    steer += np.pi * (steer < low) - np.pi * (steer > high)
    home[leg], home[part] = legs, np.clip(steer, low, high)
    return home


def branches(angle: np.ndarray, speed: np.ndarray, low: float, high: float) -> np.ndarray:
    """Angles (k,) [rad] equal to ``angle`` (k,) up to half turns, between ``low`` and ``high``, that turn as little as possible.

    By dynamic programming over the samples. To turn costs more the faster the wheel rolls (``speed`` (k,) [m/s]); wheels
    that stand keep their angle; angles close to the limits cost a little. Limits may be infinite.
    """
    moving = speed > STANDS
    if not moving.any():
        return np.full(angle.size, float(np.clip(0.0, low, high)))
    # a wheel that stands is already as it will be, or still as it was
    known = np.flatnonzero(moving)
    angle = angle[known[np.clip(np.searchsorted(known, np.arange(angle.size)), 0, known.size - 1)]]
    # a range without an end, or of very many turns, as far as the way can lead
    wound = np.unwrap((angle + np.pi) % (2.0 * np.pi) - np.pi, period=np.pi)
    low, high = max(low, wound.min() - WINDING), min(high, wound.max() + WINDING)
    half = np.arange(np.floor((low - high) / np.pi), np.ceil((high - low) / np.pi) + 1.0)
    options = (angle + np.pi) % (2.0 * np.pi) - np.pi
    options = options[:, None] + np.pi * half
    near = np.clip(0.3 - np.minimum(options - low, high - options), 0.0, None)
    cost = np.where((options >= low) & (options <= high), near, np.inf)
    total, came = cost[0] + 0.1 * np.abs(options[0]), np.zeros(options.shape, int)
    for k in range(1, len(options)):
        turn = np.abs(options[k][:, None] - options[k - 1][None, :]) * (0.1 + speed[k] / STANDS)
        through = total[None, :] + turn
        came[k] = np.argmin(through, axis=1)
        total = through.min(axis=1) + cost[k] * TURN_SHARE
    best = [int(np.argmin(total))]
    for k in range(len(options) - 1, 0, -1):
        best.append(int(came[k, best[-1]]))
    return np.asarray(options[np.arange(len(options)), best[::-1]])


def carried_poses(robot: RobotModel, home: np.ndarray, poses: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Positions (k, 3) and quaternions (k, 4) of an end effector that rides along with base poses (k, 3) as it is at ``home``."""
    place, orientation = robot.pose(home)
    turns = np.array([lie.quaternion_multiply(lie.quaternion_about((0, 0, 1), p[2]), orientation) for p in poses])
    points = np.array([[*lie.se2_compose(p, [place[0], place[1], 0.0])[:2], place[2]] for p in poses])
    return points, turns
