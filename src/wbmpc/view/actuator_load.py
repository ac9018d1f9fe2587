"""How near a robot's drives are to their limits, by group of joints."""

from __future__ import annotations

import numpy as np

from wbmpc.robots import RobotDescription

Array = np.ndarray
#: Numbers of the groups that a robot may have, in their order: arm, those of its base by their captions, and ``drives`` that are
#: commanded by torque: the others' limits are speeds.
GROUPS = tuple(f"load {i}" for i in range(6))


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
        """Names of the groups that this robot has, as many as there are :data:`GROUPS`."""
        return (*self._places, *(("drives",) if np.isfinite(self._torques).any() else ()))[: len(GROUPS)]

    def shares(self, speeds: Array, forces: Array | None = None) -> dict[str, float]:
        """The largest speed over its limit of each group, by :data:`GROUPS`; nan for groups that there are not.

        ``speeds`` (joints) [rad/s]; ``forces``: of all drives [N m], those commanded by torque first (left out: not
        known).
        """
        ratio = np.abs(speeds) / self._limits
        found = [float(ratio[places].max()) for places in self._places.values()]
        if forces is not None and "drives" in self.groups:
            found.append(float((np.abs(forces[: self._torques.size]) / self._torques).max()))
        return {**dict.fromkeys(GROUPS, np.nan), **dict(zip(GROUPS, found, strict=False))}
