"""What the simulated robot's node needs to know of each kind of plant: readings by group, commands from groups."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from wbmpc import lie
from wbmpc.errors import InputError
from wbmpc.model import RobotModel
from wbmpc.plant import RezeroCommand, RezeroPlant, SwerveCommand, SwervePlant, Truth
from wbmpc.plant.perturbation import Perturbation
from wbmpc.ros2.convert import seconds, upright
from wbmpc.ros2.settings import GROUPS, RosSettings, settings_of

Array = np.ndarray
#: Of the position loop of a simulated joint_trajectory_controller [1/s]; a speed below the other one [rad/s] is rest for it.
_GAIN, AT_REST = 10.0, float(np.finfo(np.float32).eps)


@dataclass(frozen=True)
class Reading:
    """Encoders [rad] by group, gyro (3) [rad/s], accelerometer (3) [m/s²], read ``age`` [s] ago."""

    joints: dict[str, Array]
    gyro: Array
    accel: Array
    age: float = 0.0


@dataclass(frozen=True)
class Led:
    """A trajectory that drives follow: ``positions`` and ``velocities`` (n, joints) at ``times`` (n) [s] of the bus."""

    places: list[tuple[str, int]]
    times: Array
    positions: Array
    velocities: Array

    def at(self, now: float) -> tuple[Array, Array]:
        """Position and velocity at a time; at rest at the end once it is over."""
        columns = lambda values: np.array([np.interp(now, self.times, v) for v in values.T])
        over = now > self.times[-1]
        return columns(self.positions), columns(self.velocities) * (0.0 if over else 1.0)


class _Side:
    """``held``: it falls without commands; ``lift`` [m] of the model's origin above the floor; ``imu_at`` (3) [m] in the base."""

    held, lift, imu_at = False, 0.0, np.zeros(3)

    def __init__(self) -> None:
        self.led: dict[str, Led] = {}
        self.last: Reading | None = None

    def lead(self, joints: list[str], places: list[tuple[str, int]], message: Any, now: float) -> Led:
        """A JointTrajectory of ``joints``, checked by the rules of ros2_control's joint_trajectory_controller as it is configured
        when nothing is said: all joints once, times that rise, an end that is not over yet and at rest. Raises
        :class:`InputError`."""
        names = list(message.joint_names)
        if sorted(names) != sorted(joints):
            raise InputError(f"trajectory: the joints {', '.join(joints)} are needed, got {', '.join(names)}")
        order = [names.index(n) for n in joints]
        if not message.points:
            raise InputError("trajectory: it has no points")
        after = np.array([seconds(p.time_from_start) for p in message.points])
        positions = _rows("positions", [p.positions for p in message.points], len(order))
        speeds = [p.velocities for p in message.points]
        velocities = _rows("velocities", speeds, len(order)) if any(map(len, speeds)) else np.zeros_like(positions)
        if after[0] < 0.0 or np.any(np.diff(after) <= 0.0):
            raise InputError(f"trajectory: times from its start must rise from 0 on, got {after.tolist()} s")
        start = seconds(message.header.stamp)
        if start and start + after[-1] < now:
            raise InputError(f"trajectory: it ended {now - start - after[-1]:.3f} s ago")
        if np.any(np.abs(velocities[-1]) > AT_REST):
            raise InputError(
                f"trajectory: its last point must be at rest, got velocities {velocities[-1].tolist()} rad/s"
            )
        return Led(places, (start or now) + after, positions[:, order], velocities[:, order])

    def track(self, groups: dict[str, Array], now: float) -> None:
        """Speeds of the drives that follow a trajectory, in place."""
        for led in self.led.values():
            position, velocity = led.at(now)
            assert self.last is not None
            for (group, i), p, v in zip(led.places, position, velocity, strict=True):
                groups[group][i] = v + _GAIN * (p - self.last.joints[group][i])


def _rows(what: str, given: list[Any], joints: int) -> Array:
    """One row of finite numbers for each point, or :class:`InputError`."""
    if any(len(row) != joints for row in given):
        raise InputError(f"trajectory: every point needs {joints} {what}, got {[len(row) for row in given]}")
    rows = np.array([np.asarray(row, float) for row in given])
    if not np.isfinite(rows).all():
        raise InputError(f"trajectory: {what} must be finite")
    return rows


class SwerveSide(_Side):
    """A swerve robot: speeds and brakes."""

    def __init__(self, robot: RobotModel, perturbation: Perturbation | None, seed: int) -> None:
        super().__init__()
        self.robot = robot
        self.plant = SwervePlant(robot.description, robot.state.split(robot.home), perturbation, seed)
        self._sizes = {g: len(robot.input.groups.get("leg" if g == "brake" else g, ())) for g in GROUPS}

    def rest(self) -> dict[str, Array]:
        """Everything at rest, brakes closed."""
        return {g: np.zeros(n) for g, n in self._sizes.items()}

    def command(self, groups: dict[str, Array]) -> SwerveCommand:
        """What the drives get; four brakes for fixed legs, as the plant wants them."""
        return SwerveCommand(**groups)

    def read(self) -> Reading:
        """What the sensors say."""
        m = self.plant.measure()
        self.last = Reading({"leg": m.leg, "steer": m.steer, "wheel": m.wheel, "arm": m.arm}, m.gyro, m.accel)
        return self.last

    def base(self, truth: Truth) -> tuple[Array, Array]:
        """Position and quaternion of the base."""
        return upright(truth.pose, self.robot.base.height)


class BallSide(_Side):
    """A ball robot: torques. It is held until the first ones come."""

    held = True

    def __init__(self, robot: RobotModel, perturbation: Perturbation | None, seed: int) -> None:
        super().__init__()
        self.robot, self.lift = robot, robot.base.radius
        self.plant = RezeroPlant(
            robot.description, *robot.equilibrium(robot.home[robot.state["arm"]]), perturbation, seed
        )
        self.imu_at = self.plant.sensors.mount

    def rest(self) -> dict[str, Array]:
        """No torque."""
        return {g: np.zeros(len(self.robot.input.groups[g])) for g in ("wheel", "arm")}

    def command(self, groups: dict[str, Array]) -> RezeroCommand:
        """What the drives get."""
        return RezeroCommand(np.concatenate([groups["wheel"], groups["arm"]]))

    def read(self) -> Reading:
        """What the sensors say; inertial readings are averages since the message before."""
        m = self.plant.measure()
        none = np.zeros(0)
        joints = {"leg": none, "steer": none, "wheel": m.wheel, "arm": m.arm}
        self.last = Reading(joints, m.gyro, m.accel, m.age)
        return self.last

    def base(self, truth: Truth) -> tuple[Array, Array]:
        """Position and quaternion of the base, which leans; its frame is the ball's centre."""
        rotation = truth.tool_rotation @ truth.tool_rotation_in_base.T
        return np.array([*truth.pose[:2], self.lift]), lie.rotation_to_quaternion(rotation)


def plant_of(
    robot: RobotModel, settings: RosSettings, perturbation: Perturbation | None, seed: int
) -> SwerveSide | BallSide:
    """The simulated robot; raises :class:`InputError` for kinds of bases that there is none for."""
    settings_of(robot)
    made = BallSide if robot.description.base.type == "ball" else SwerveSide
    return made(robot, perturbation, seed)
