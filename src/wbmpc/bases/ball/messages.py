"""What ball robots take and give: torques and servo goals of their drives, measurements of their sensors."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from wbmpc.arrays import Array

#: Of commands that ask for nothing beside torques.
_NOTHING = np.zeros(0)
_NOTHING.flags.writeable = False


def _nothing() -> Array:
    return _NOTHING


@dataclass(frozen=True)
class BallCommand:
    """Torques [N m]: omni wheels, then arm joints. With ``stiffness`` [N m/rad] and ``damping`` [N m s/rad] the drives add
    what these ask for about ``position`` [rad], which moves on with ``speed`` [rad/s]; none of the four: torque alone."""

    torque: Array
    position: Array = field(default_factory=_nothing)
    speed: Array = field(default_factory=_nothing)
    stiffness: Array = field(default_factory=_nothing)
    damping: Array = field(default_factory=_nothing)

    @classmethod
    def plain(cls, torque: Array) -> BallCommand:
        """Of torques alone."""
        made = object.__new__(cls)  # many times as fast as __init__
        vars(made).update(torque=torque, position=_NOTHING, speed=_NOTHING, stiffness=_NOTHING, damping=_NOTHING)
        return made


@dataclass(frozen=True)
class BallMeasurement:
    """What a ball robot's sensors say, ``age`` [s] before ``time`` [s]; and, idealized, its state (16) with noise.

    ``wheel`` (n), ``arm`` (m) [rad]: encoders; ``gyro`` (3) [rad/s] and ``accel`` (3) [m/s²]: angular rate and specific
    force in the axes of the base, averages since the message before (the inertial unit integrates between messages);
    ``force`` (3) [N]: of a sensor in the end effector, in its axes, on the end effector (none where there is no sensor).
    """

    time: float
    state: Array
    age: float
    wheel: Array = field(default_factory=lambda: np.zeros(3))
    arm: Array = field(default_factory=lambda: np.zeros(3))
    gyro: Array = field(default_factory=lambda: np.zeros(3))
    accel: Array = field(default_factory=lambda: np.zeros(3))
    force: Array = field(default_factory=lambda: np.zeros(0))

    def with_state(self, state: Array) -> BallMeasurement:
        """The same with another state."""
        made = object.__new__(type(self))  # many times as fast as dataclasses.replace
        vars(made).update(vars(self), state=state)
        return made
