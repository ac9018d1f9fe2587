"""A base type of somebody who has installed the package: everything is reached through ``wb``. `mypy` checks it as strictly as
``--strict`` does (pyproject.toml), and tests/test_public_api.py loads a robot with it."""

from __future__ import annotations

from typing import Literal

import casadi as ca
import mujoco
import numpy as np
from numpy.typing import NDArray

import wbmpc as wb

Array = NDArray[np.float64]


class RailDescription(wb.BaseDescription):
    """A cart on a straight rail: the name of its sliding joint."""

    type: Literal["rail"]
    axis: str

    def joint_groups(self) -> dict[str, list[str]]:
        return {"rail": [self.axis]}


class RailBase:
    """State and input: the cart's position and speed, and the arm's. The rail's frame is the model's world."""

    def __init__(self, description: wb.RobotDescription, spec: mujoco.MjSpec) -> None:
        self.tree = wb.read_tree(spec, description.base.body)
        self.state = {**description.base.joint_groups(), "arm": list(description.arm.joints)}
        self.input = self.state
        self._links = [self.tree.joint(name) for names in self.state.values() for name in names]
        self.parameters: dict[str, list[str]] = {}
        self.mode: dict[str, list[str]] = {}
        self.mode_bounds: dict[str, tuple[float, float]] = {}
        self.unit_quaternions: tuple[int, ...] = ()
        self.brakes: dict[str, str] = {}
        self.rolling_groups: tuple[str, ...] = ()
        self.steering_groups: tuple[str, ...] = ()
        self.ground, self.body_height, self.balances, self.wheels = 0.0, 0.0, False, 0
        self.footprint: wb.Footprint | None = None
        self.twist: Array = np.eye(3)

    def root(self, x: ca.SX) -> wb.FramePose:
        return wb.FramePose(ca.SX(3, 1), ca.SX([1.0, 0.0, 0.0, 0.0]), ca.SX.eye(3))

    def chain(self, x: ca.SX) -> wb.Chain:
        return wb.Chain(self.tree.links, {link: x[k] for k, link in enumerate(self._links)}, self.root(x))

    def motion(self, x: ca.SX, u: ca.SX) -> tuple[dict[int, ca.SX], ca.SX, ca.SX]:
        return {link: u[k] for k, link in enumerate(self._links)}, ca.SX(3, 1), ca.SX(3, 1)

    def derivative(self, x: ca.SX, u: ca.SX, w: ca.SX, m: ca.SX) -> ca.SX:
        return u

    def rolling(self, x: ca.SX, u: ca.SX, m: ca.SX) -> ca.SX:
        return ca.SX(0, 1)

    def constraints(self, robot: wb.RobotModel, *, hard: bool = True) -> list[wb.Constraint]:
        return []

    def limits(self, description: wb.RobotDescription) -> wb.Limits:
        return wb.joint_limits(self, description, tuple(self.state), description.limits.velocity, {}, {})

    def home(self, robot: wb.RobotModel) -> Array:
        return wb.joint_home(self, robot.description, tuple(self.state))


class RailBaseType(wb.BaseType):
    """The plug-in."""

    Description = RailDescription

    def check(self, description: wb.RobotDescription, model: mujoco.MjModel) -> None:
        if not isinstance(description.base, RailDescription):
            raise wb.InputError(f"{description.source}: key 'base.type': a rail is needed")

    def model(self, description: wb.RobotDescription, spec: mujoco.MjSpec) -> wb.Base:
        return RailBase(description, spec)
