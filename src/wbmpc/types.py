"""What plants take and give."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


def scale_wheels(wheel: ArrayLike, limit: float) -> tuple[Array, float]:
    """Wheel speeds (n) [rad/s] scaled together to ``limit``, and the factor (at most 1).

    The factor applies to the whole motion of the base: wheels that are clipped one by one drag each other.
    """
    wheel = np.asarray(wheel, float)
    factor = min(1.0, limit / max(float(np.abs(wheel).max(initial=0.0)), 1e-12))
    return wheel * factor, factor


@dataclass(frozen=True)
class SwerveCommand:
    """Speeds of wheels (n), steering (n) and arm joints [rad/s]; brakes (n, or 0 for fixed legs), 1 = open."""

    wheel: Array
    steer: Array
    arm: Array
    brake: Array

    @classmethod
    def stop(cls, modules: int = 4, arm: int = 6) -> SwerveCommand:
        """Everything at rest, brakes closed."""
        return cls(np.zeros(modules), np.zeros(modules), np.zeros(arm), np.zeros(modules))


@dataclass(frozen=True)
class GlobalPose:
    """What a localisation says: ``pose`` (x, y, yaw) of the base at ``time`` [s], with its ``covariance`` (3, 3)."""

    time: float
    pose: Array
    covariance: Array


@dataclass(frozen=True)
class SwerveMeasurement:
    """Positions [rad] as the encoders report them at ``time`` [s] (``leg`` is empty for fixed legs).

    ``gyro`` (3) [rad/s] and ``accel`` (3) [m/s²]: inertial unit, axes of the base; at rest ``accel`` points up.
    ``place``: a global pose that has just come in, older than the message.
    """

    time: float
    leg: Array
    steer: Array
    wheel: Array
    arm: Array
    gyro: Array = field(default_factory=lambda: np.zeros(3))
    accel: Array = field(default_factory=lambda: np.zeros(3))
    place: GlobalPose | None = None


@dataclass(frozen=True)
class BallCommand:
    """Torques [N m]: omni wheels, then arm joints. With ``stiffness`` [N m/rad] and ``damping`` [N m s/rad] the drives add
    what these ask for about ``position`` [rad], which moves on with ``speed`` [rad/s]; none of the four: torque alone."""

    torque: Array
    position: Array = field(default_factory=lambda: np.zeros(0))
    speed: Array = field(default_factory=lambda: np.zeros(0))
    stiffness: Array = field(default_factory=lambda: np.zeros(0))
    damping: Array = field(default_factory=lambda: np.zeros(0))


@dataclass(frozen=True)
class BallMeasurement:
    """What a ball robot's sensors say, ``age`` [s] before ``time`` [s]; and, idealised, its state (16) with noise.

    ``wheel`` (n), ``arm`` (m) [rad]: encoders; ``gyro`` (3) [rad/s] and ``accel`` (3) [m/s²]: angular rate and specific
    force in the axes of the base, averages since the message before (the inertial unit integrates between messages);
    ``force`` (3) [N]: of a sensor in the hand, in its axes, on the hand (none where there is no sensor).
    """

    time: float
    state: Array
    age: float
    wheel: Array = field(default_factory=lambda: np.zeros(3))
    arm: Array = field(default_factory=lambda: np.zeros(3))
    gyro: Array = field(default_factory=lambda: np.zeros(3))
    accel: Array = field(default_factory=lambda: np.zeros(3))
    force: Array = field(default_factory=lambda: np.zeros(0))


@dataclass(frozen=True)
class Truth:
    """What really is.

    ``pose`` (x, y, yaw) of the base, yaw not wrapped; ``tilt`` [rad] of its z axis; ``tool`` (3) [m] and
    ``tool_rotation`` (3, 3) in the world of the planner (its z = 0 is the floor; for a ball robot the ball's centre);
    ``tool_in_base`` and ``tool_rotation_in_base`` in the base's own (also tilted) frame; ``state`` in the planner's
    layout; ``joints`` [rad] by name. With wheels: ``slip`` (n) [m/s], speed of the contact points over the floor;
    ``slip_along`` (n, 2) its parts along the wheel and along its axle; ``wheel_force`` (n) [N], vertical forces of
    the ground in the last physics step. ``joint_speeds`` [rad/s] by name.
    """

    time: float
    pose: Array
    tool: Array
    tool_rotation: Array
    tool_in_base: Array
    tool_rotation_in_base: Array
    tilt: float
    state: Array
    joints: dict[str, float]
    slip: Array = field(default_factory=lambda: np.zeros(0))
    slip_along: Array = field(default_factory=lambda: np.zeros((0, 2)))
    wheel_force: Array = field(default_factory=lambda: np.zeros(0))
    joint_speeds: dict[str, float] = field(default_factory=dict)


CommandT = TypeVar("CommandT", contravariant=True)
MeasurementT = TypeVar("MeasurementT", covariant=True)


class Plant(Protocol[CommandT, MeasurementT]):
    """A simulated robot. ``timestep`` [s]; ``step`` holds a command for n steps; ``measure`` belongs to ``time``."""

    timestep: float

    @property
    def time(self) -> float: ...

    @property
    def fell(self) -> bool: ...

    @property
    def diverged(self) -> bool: ...

    def measure(self) -> MeasurementT: ...

    def step(self, command: CommandT, steps: int = 1) -> None: ...

    def truth(self) -> Truth: ...
