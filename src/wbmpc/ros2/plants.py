"""What the simulated robot's node needs to know of its plant: readings by group, commands from groups."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, ClassVar, cast

import numpy as np

from wbmpc.arrays import Array
from wbmpc.bases import base_type
from wbmpc.bases.base import WHEELS
from wbmpc.errors import InputError
from wbmpc.model.robot import RobotModel
from wbmpc.ros2.convert import check_numbers, seconds, upright
from wbmpc.ros2.settings import drive_groups, joint_groups
from wbmpc.types import SimulatedRobot, Truth

#: Of the position loop of a simulated joint_trajectory_controller [1/s]; a speed below the other one [rad/s] is rest for it.
_GAIN, AT_REST = 10.0, float(np.finfo(np.float32).eps)


@dataclass(frozen=True)
class Reading:
    """Encoders [rad] by group, gyro (3) [rad/s], accelerometer (3) [m/s²], read ``age`` [s] ago. ``way`` (m) [m, rad]: of a base that
    takes speeds, along each of them."""

    joints: dict[str, Array]
    gyro: Array
    accel: Array
    age: float = 0.0
    way: Array | None = None


@dataclass(frozen=True)
class ActiveTrajectory:
    """A trajectory that drives follow: ``positions`` and ``velocities`` (n, joints) at ``times`` (n) [s] of the bus."""

    places: list[tuple[str, int]]
    times: Array
    positions: Array
    velocities: Array

    def at(self, now: float) -> tuple[Array, Array]:
        """Position and velocity at a time, between the points by straight lines; at rest at the end once it is over."""
        columns = lambda values: np.array([np.interp(now, self.times, v) for v in values.T])
        over = now > self.times[-1]
        return columns(self.positions), columns(self.velocities) * (0.0 if over else 1.0)


class RosPlant:
    """A simulated robot's side of the bus; each base type has its own, see :meth:`wbmpc.bases.base.BaseType.ros_plant`.

    ``held``: it falls without commands; ``lift`` [m] of the model's origin above the floor; ``imu_at`` (3) [m] in the base;
    ``led``: trajectories that controllers follow, by their names; ``last``: what was read last. Groups: see
    :func:`wbmpc.ros2.settings.drive_groups`.
    """

    imu_at = np.zeros(3)
    #: what the plant takes, of one array for each group of drives
    Command: ClassVar[Callable[..., Any]]

    def __init__(self, robot: RobotModel, plant: SimulatedRobot) -> None:
        self.robot, self.plant = robot, plant
        self.held, self.lift = robot.base.balances, -robot.base.ground
        self.led: dict[str, ActiveTrajectory] = {}
        self.last: Reading | None = None

    def rest(self) -> dict[str, Array]:
        """Commands by group that keep the robot at rest, brakes closed."""
        return {g: np.zeros(len(names)) for g, names in drive_groups(self.robot).items()}

    def command(self, groups: dict[str, Array]) -> Any:
        """The plant's command of what each group gets."""
        return type(self).Command(**groups)

    def read(self) -> Reading:
        """What the sensors say, by measurements that have groups of joints by their names; kept as ``last``. A base that takes speeds counts
        its way as wheels do."""
        m, way = self.plant.measure(), None
        joints = {g: getattr(m, g) for g in joint_groups(self.robot)}
        if self.robot.description.base.takes_twist:
            way, joints[WHEELS] = joints[WHEELS], np.zeros(0)
        self.last = Reading(joints, m.gyro, m.accel, getattr(m, "age", 0.0), way)
        return self.last

    def base(self, truth: Truth) -> tuple[Array, Array]:
        """True position (3) [m] above the floor and quaternion (4) of the base's frame."""
        return upright(truth.pose, self.robot.base.body_height)

    def lead(self, joints: list[str], places: list[tuple[str, int]], message: Any, now: float) -> ActiveTrajectory:
        """A JointTrajectory of ``joints``, checked by the rules of ros2_control's joint_trajectory_controller as it is configured
        when nothing is said: all joints once, times that rise, an end that is not over yet and at rest. Raises
        :class:`InputError`."""
        names = list(message.joint_names)
        if sorted(names) != sorted(joints):
            got = ", ".join(names[: len(joints) + 1])
            raise InputError(f"trajectory: the joints {', '.join(joints)} are needed, got {len(names)} ({got})")
        order = [names.index(n) for n in joints]
        if not message.points:
            raise InputError("trajectory: it has no points")
        after = np.array([seconds(p.time_from_start) for p in message.points])
        given = {
            n: [getattr(p, n) for p in message.points] for n in ("positions", "velocities", "accelerations", "effort")
        }
        if any(map(len, given["effort"])):
            raise InputError("trajectory: efforts are not supported")
        filled = {n: _rows(n, rows, len(order)) for n, rows in given.items() if n == "positions" or any(map(len, rows))}
        positions = filled["positions"]
        velocities = filled.get("velocities", np.zeros_like(positions))
        wrong = np.flatnonzero(np.diff(after, prepend=-1e-12) <= 0.0)
        if wrong.size:
            k = int(wrong[0])
            before = f"{after[k - 1]:g} s before it" if k else "it is the first one"
            raise InputError(
                f"trajectory: times from its start must rise from 0 on, point {k} has {after[k]:g} s, {before}"
            )
        start = seconds(message.header.stamp)
        if start and start + after[-1] < now:
            raise InputError(f"trajectory: it ended {now - start - after[-1]:.3f} s ago")
        if np.any(np.abs(velocities[-1]) > AT_REST):
            raise InputError(
                f"trajectory: its last point must be at rest, got velocities {velocities[-1].tolist()} rad/s"
            )
        times = (start or now) + after
        found = ActiveTrajectory(places, times, positions[:, order], velocities[:, order])
        return self._from_here(found, now) if times[0] > now else found

    def _from_here(self, next_one: ActiveTrajectory, now: float) -> ActiveTrajectory:
        """The way to the first point of a trajectory is from where the drives are, at the speed of the one that they follow."""
        if self.last is None:
            return next_one
        position = np.array([self.last.joints[group][i] for group, i in next_one.places])
        going = next(
            (led.at(now)[1] for led in self.led.values() if led.places == next_one.places), np.zeros(position.size)
        )
        times, positions = np.append(now, next_one.times), np.vstack([position, next_one.positions])
        return replace(next_one, times=times, positions=positions, velocities=np.vstack([going, next_one.velocities]))

    def track(self, groups: dict[str, Array], now: float) -> None:
        """Speeds of the drives that follow a trajectory, in place."""
        for led in self.led.values():
            position, velocity = led.at(now)
            assert self.last is not None
            for (group, i), p, v in zip(led.places, position, velocity, strict=True):
                groups[group][i] = v + _GAIN * (p - self.last.joints[group][i])


def _rows(what: str, values: list[Any], joints: int) -> Array:
    """One row of finite numbers for each point, or :class:`InputError`."""
    short = next((k for k, row in enumerate(values) if len(row) != joints), None)
    if short is not None:
        raise InputError(f"trajectory: every point needs {joints} {what}, point {short} has {len(values[short])}")
    return check_numbers(np.array([np.asarray(row, float) for row in values]), f"trajectory, {what}")


def plant_of(robot: RobotModel, seed: int) -> RosPlant:
    """The simulated robot; raises :class:`InputError` where its base type has none for ROS 2."""
    return cast(RosPlant, base_type(robot.description.base.type).ros_plant(robot, None, seed))
