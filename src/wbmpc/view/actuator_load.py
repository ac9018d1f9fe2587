"""How near a robot's drives are to their limits, by group of joints."""

from __future__ import annotations

import numpy as np

from wbmpc.arrays import Array
from wbmpc.robots import RobotDescription

#: Names of the groups; ``drives`` are those of a base that are commanded by torque: the others' limits are speeds.
GROUPS = ("arm", "legs", "steering", "wheels", "drives")


class Loads:
    """Of one robot; ``joints``: names of the joints whose speeds are given. Joints without a limit count in no group."""

    def __init__(self, robot: RobotDescription, joints: list[str]) -> None:
        base, limits = robot.base, robot.limits
        groups = base.joint_groups()
        members = {"arm": robot.arm.joints, **{name: groups.get(group, []) for group, name in base.captions.items()}}
        self._limits = np.array([limits.velocity.get(name, np.inf) for name in joints])
        places = {
            group: [i for i, joint in enumerate(joints) if joint in names and np.isfinite(self._limits[i])]
            for group, names in members.items()
        }
        self._places = {group: found for group, found in places.items() if found}
        self._torques = np.array(base.torque_limits(limits))

    @property
    def groups(self) -> tuple[str, ...]:
        """The groups that this robot has, of :data:`GROUPS`."""
        return (*self._places, *(("drives",) if np.isfinite(self._torques).any() else ()))

    def shares(self, speeds: Array, forces: Array | None = None) -> dict[str, float]:
        """The largest speed over its limit of each group, nan for groups that there are not.

        ``speeds`` (joints) [rad/s]; ``forces``: of all drives [N m], those commanded by torque first (left out: not
        known).
        """
        ratio = np.abs(speeds) / self._limits
        found = {group: float(ratio[places].max()) for group, places in self._places.items()}
        if forces is not None and "drives" in self.groups:
            found["drives"] = float((np.abs(forces[: self._torques.size]) / self._torques).max())
        return {group: found.get(group, np.nan) for group in GROUPS}
