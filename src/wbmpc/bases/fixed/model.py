"""A base that does not move: the arm alone, moved by its joint rates."""

from __future__ import annotations

from typing import TYPE_CHECKING

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from wbmpc import lie
from wbmpc.model.joints import Limits, joint_home, joint_limits
from wbmpc.model.kinematics import Chain, FramePose, constant
from wbmpc.model.tree import Tree
from wbmpc.robots import RobotDescription
from wbmpc.units import rate_unit

if TYPE_CHECKING:
    from wbmpc.bases.footprint import Footprint
    from wbmpc.model.robot import RobotModel
    from wbmpc.ocp import Constraint


class FixedBase:
    """Kinematic arm: state joint angles, input joint rates."""

    def __init__(self, description: RobotDescription, tree: Tree, position: np.ndarray, quaternion: np.ndarray) -> None:
        self.tree, self.position, self.quaternion = tree, position, quaternion
        arm = list(description.arm.joints)
        self._joints = [tree.joint(n) for n in arm]
        self.state, self.input = {"arm": arm}, {"arm": arm}
        self.state_units = {"arm": tree.units(arm)}
        self.input_units = {"arm": [rate_unit(unit) for unit in self.state_units["arm"]]}
        self.mode: dict[str, list[str]] = {}
        self.parameters: dict[str, list[str]] = {}
        self.unit_quaternions: tuple[int, ...] = ()
        self.mode_bounds: dict[str, tuple[float, float]] = {}
        self.brakes: dict[str, str] = {}
        self.rolling_groups: tuple[str, ...] = ()
        self.steering_groups: tuple[str, ...] = ()
        self.footprint: Footprint | None = None
        self.twist: NDArray[np.float64] = np.eye(3)
        self.wheels, self.balances = 0, False
        self.ground, self.body_height = 0.0, float(position[2])

    def root_pose(self, x: ca.SX) -> FramePose:
        """Pose of the body's frame."""
        rotation = constant(lie.quaternion_to_rotation(self.quaternion))
        return FramePose(constant(self.position), constant(self.quaternion), rotation)

    def chain(self, x: ca.SX) -> Chain:
        """The tree at a state."""
        return Chain(self.tree.links, {link: x[k] for k, link in enumerate(self._joints)}, self.root_pose(x))

    def velocities(self, x: ca.SX, u: ca.SX) -> tuple[dict[int, ca.SX], ca.SX, ca.SX]:
        """Joint rates by link; the root stands."""
        return {link: u[k] for k, link in enumerate(self._joints)}, ca.SX(3, 1), ca.SX(3, 1)

    def derivative(self, x: ca.SX, u: ca.SX, w: ca.SX, m: ca.SX) -> ca.SX:
        return u

    def rolling(self, x: ca.SX, u: ca.SX, m: ca.SX) -> ca.SX:
        """No rows: nothing rolls."""
        return ca.SX(0, 1)

    def constraints(self, robot: RobotModel, *, hard: bool = True) -> list[Constraint]:
        """None: every joint rate is possible."""
        return []

    def limits(self, description: RobotDescription) -> Limits:
        """Ranges (state), speeds and accelerations (input) of the arm's joints."""
        limits = description.limits
        return joint_limits(self, description, ("arm",), limits.velocity, limits.acceleration, {})

    def home(self, robot: RobotModel) -> NDArray[np.float64]:
        return joint_home(self, robot.description, ("arm",))
