"""How near a robot's drives are to their limits, by group of joints."""

from __future__ import annotations

import numpy as np

from wbmpc.arrays import Array
from wbmpc.robots import RobotDescription

#: Places of a robot's groups among numbers that are shown; a robot with more groups shows the first ones.
SHARES = tuple(f"share_{k}" for k in range(8))
#: Drives of a base that are commanded by torque: the limits of the other groups are speeds.
DRIVES = "drives"


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
        #: Names of the robot's groups: the arm, what its base names, and :data:`DRIVES`.
        self.groups = (*self._places, *((DRIVES,) if np.isfinite(self._torques).any() else ()))[: len(SHARES)]

    def shares(self, speeds: Array, forces: Array | None = None) -> dict[str, float]:
        """The largest speed over its limit of each group, in the order of ``groups`` in the places :data:`SHARES`; nan beyond.

        ``speeds`` (joints) [rad/s]; ``forces``: of all drives [N m], those commanded by torque first (left out: not
        known).
        """
        ratio = np.abs(speeds) / self._limits
        found = {group: float(ratio[places].max()) for group, places in self._places.items()}
        if forces is not None and DRIVES in self.groups:
            found[DRIVES] = float((np.abs(forces[: self._torques.size]) / self._torques).max())
        shares = (found.get(group, np.nan) for group in self.groups)
        return dict.fromkeys(SHARES, np.nan) | dict(zip(SHARES, shares, strict=False))
