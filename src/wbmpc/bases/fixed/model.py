"""A base that does not move: the arm alone, moved by its joint rates."""

from __future__ import annotations

import casadi as ca
import numpy as np

from wbmpc import lie
from wbmpc.model.kinematics import Chain, FramePose, constant
from wbmpc.model.tree import Tree
from wbmpc.robots import RobotDescription


class FixedBase:
    """Kinematic arm: state joint angles, input joint rates."""

    def __init__(self, description: RobotDescription, tree: Tree, position: np.ndarray, quaternion: np.ndarray) -> None:
        self.tree, self.position, self.quaternion = tree, position, quaternion
        arm = list(description.arm.joints)
        self._joints = [tree.joint(n) for n in arm]
        self.state, self.input = {"arm": arm}, {"arm": arm}
        self.mode: dict[str, list[str]] = {}
        self.parameters: dict[str, list[str]] = {}
        self.unit_quaternions: tuple[int, ...] = ()

    def chain(self, x: ca.SX) -> Chain:
        """The tree at a state."""
        rotation = constant(lie.quaternion_to_rotation(self.quaternion))
        root = FramePose(constant(self.position), constant(self.quaternion), rotation)
        return Chain(self.tree.links, {link: x[k] for k, link in enumerate(self._joints)}, root)

    def motion(self, x: ca.SX, u: ca.SX) -> tuple[dict[int, ca.SX], ca.SX, ca.SX]:
        """Joint rates by link; the root stands."""
        return {link: u[k] for k, link in enumerate(self._joints)}, ca.SX(3, 1), ca.SX(3, 1)

    def derivative(self, x: ca.SX, u: ca.SX, w: ca.SX, m: ca.SX) -> ca.SX:
        """ẋ = u."""
        return u
