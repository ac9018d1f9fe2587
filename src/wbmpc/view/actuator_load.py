"""How near a robot's drives are to their limits, by group of joints."""

from __future__ import annotations

import numpy as np

from wbmpc.bases.ball.description import BallBaseDescription
from wbmpc.bases.swerve.description import SwerveBaseDescription
from wbmpc.robots import RobotDescription

Array = np.ndarray
#: Names of the groups; ``drives`` are a ball's omni wheels, whose limit is a torque: the others' are speeds.
GROUPS = ("arm", "legs", "steering", "wheels", "drives")


class Loads:
    """Of one robot; ``joints``: names of the joints whose speeds are given. Joints without a limit count in no group."""

    def __init__(self, robot: RobotDescription, joints: list[str]) -> None:
        base, limits = robot.base, robot.limits
        modules = base.modules if isinstance(base, SwerveBaseDescription) else ()
        members = {
            "arm": robot.arm.joints, "legs": [m.hinge for m in modules], "steering": [m.steer for m in modules],
            "wheels": [m.wheel for m in modules],
        }  # fmt: skip
        self._limits = np.array([limits.velocity.get(name, np.inf) for name in joints])
        places = {
            group: [i for i, joint in enumerate(joints) if joint in names and np.isfinite(self._limits[i])]
            for group, names in members.items()
        }
        self._places = {group: found for group, found in places.items() if found}
        self._wheels = len(base.wheels.azimuths) if isinstance(base, BallBaseDescription) else 0
        self._torque = limits.wheel_effort

    @property
    def groups(self) -> tuple[str, ...]:
        """The groups that this robot has, of :data:`GROUPS`."""
        return (*self._places, *(("drives",) if self._wheels and np.isfinite(self._torque) else ()))

    def shares(self, speeds: Array, forces: Array | None = None) -> dict[str, float]:
        """The largest speed over its limit of each group, nan for groups that there are not.

        ``speeds`` (joints) [rad/s]; ``forces``: of all drives [N m], a ball's wheels first (left out: not known).
        """
        ratio = np.abs(speeds) / self._limits
        found = {group: float(ratio[places].max()) for group, places in self._places.items()}
        if forces is not None and "drives" in self.groups:
            found["drives"] = float(np.abs(forces[: self._wheels]).max()) / self._torque
        return {group: found.get(group, np.nan) for group in GROUPS}
