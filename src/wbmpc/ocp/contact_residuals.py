"""Residuals of contact forces that are inputs: a tool that pushes on a surface (:mod:`wbmpc.ocp.residuals` has them all)."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from wbmpc.checks import finite
from wbmpc.errors import unknown_name
from wbmpc.model.robot import RobotModel
from wbmpc.ocp.symbols import Symbols


@dataclass(frozen=True)
class PushForce:
    """The robot's push on a surface in its axes, minus the target: along the normal, across (level), up [N].

    Reference: the unit normal (3) of an upright surface, into it, and the target force [N] along it. ``group``: the input that
    is the force of the world on the robot, world axes.
    """

    robot: RobotModel
    group: str = "force"

    size, reference = 3, 4
    groups = {"push": slice(0, 1), "across": slice(1, 2), "up": slice(2, 3)}  # noqa: RUF012

    def __post_init__(self) -> None:
        if self.group not in self.robot.input:
            raise unknown_name("input group", self.group, self.robot.input.groups, where=self.robot.description.name)

    def __call__(self, s: Symbols) -> ca.SX:
        push = push_on_surface(-s.u[self.robot.input[self.group]], s.reference[0:3])
        return push - ca.vertcat(s.reference[3], 0.0, 0.0)


def push_on_surface(force: ca.SX, normal: ca.SX) -> ca.SX:
    """A force (3) [N] in the axes of an upright surface: along its unit normal (3), across, up."""
    return ca.vertcat(ca.dot(normal, force), normal[0] * force[1] - normal[1] * force[0], force[2])


@dataclass(frozen=True)
class FrictionCone:
    """Contact force of an end effector that pushes and does not slide: rows [N], all to be at least zero.

    Reference: the unit normal n (3) of an upright surface, into it, and the friction coefficient μ, which may be estimated on-line. With
    the robot's push F = −(force of the world on it): ``push``: nᵀF − ``min_push`` [N]; ``cone``: a pyramid inside the friction cone,
    μ nᵀF/√2 ± F along two tangents. ``group`` of the input that is the force of the world.
    """

    robot: RobotModel
    min_push: float = 0.0
    group: str = "force"

    size, reference = 5, 4
    groups = {"push": slice(0, 1), "cone": slice(1, 5)}  # noqa: RUF012

    def __post_init__(self) -> None:
        if self.group not in self.robot.input:
            raise unknown_name("input group", self.group, self.robot.input.groups, where=self.robot.description.name)
        finite("friction cone", min_push=self.min_push)

    def __call__(self, s: Symbols) -> ca.SX:
        push, side, rise = ca.vertsplit(push_on_surface(-s.u[self.robot.input[self.group]], s.reference[0:3]))
        maximum = s.reference[3] / np.sqrt(2.0) * push
        return ca.vertcat(push - self.min_push, maximum - side, maximum + side, maximum - rise, maximum + rise)
