"""What ball robots take and give: torques of their drives, measurements of their sensors."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from wbmpc.arrays import Array


@dataclass(frozen=True)
class BallCommand:
    """Torques [N m]: omni wheels, then arm joints."""

    torque: Array


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
