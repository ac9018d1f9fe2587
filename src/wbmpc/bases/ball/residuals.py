"""Residuals of robots that balance on a ball."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import casadi as ca
import numpy as np

from wbmpc.bases.ball.balance import load_offset
from wbmpc.bases.ball.model import ball_base
from wbmpc.checks import finite, positive, whole_number
from wbmpc.model.robot import RobotModel
from wbmpc.ocp.symbols import Symbols


@dataclass(frozen=True)
class BallSpin:
    """Torque (1) [N m] of the wheels on a ball about the vertical: more than the floor's spin friction spins the ball. What leans a base
    that leans already is part of it."""

    robot: RobotModel

    size, reference = 1, 0
    groups = {"torque": slice(0, 1)}  # noqa: RUF012

    def __call__(self, s: Symbols) -> ca.SX:
        up = self.robot.base.root_pose(s.x[: ball_base(self.robot).nq]).rotation[2, :]
        return up @ ca.DM(ball_base(self.robot).wheel_torque_map()) @ s.u[self.robot.input["wheel"]]


@dataclass(frozen=True)
class CapturePoint:
    """Divergent component [m] of a ball robot's lean along ``directions`` that divide half a turn evenly, the first along x:
    horizontal offset of the load's center of mass from the ball plus its rate over ``pole`` [1/s]
    (:class:`wbmpc.bases.ball.balance.Balance`). What it has beyond the wheels' reach cannot be stopped.

    In a box this is a polygon around a circle. Four directions: by at most 8 % too wide; two (a square) would be by 41 %, and
    pushes along its diagonals then fell the robot at less than half the impulse.

    ``answer`` [m/N] (:class:`wbmpc.bases.ball.balance.Balance`), if not zero: the reference is the horizontal force (2) [N] of the world on
    the end effector that is expected, and the component is counted from the lean that answers it. ``pushed``: the parameters ``push``
    are added, so that a limit leaves room for what a push will do that the plan does not know.
    """

    robot: RobotModel
    pole: float
    directions: int = 4
    answer: float = 0.0
    pushed: bool = False

    def __post_init__(self) -> None:
        positive("capture point", pole=self.pole)
        finite("capture point", answer=self.answer)
        whole_number("capture point: directions", self.directions, 1)

    @property
    def reference(self) -> int:
        return 2 if self.answer else 0

    @property
    def size(self) -> int:
        return self.directions

    @property
    def groups(self) -> dict[str, slice]:
        return {"offset": slice(0, self.directions)}

    def __call__(self, s: Symbols) -> ca.SX:
        base = ball_base(self.robot)
        n = base.nq
        offset = load_offset(base, s.x[:n], s.parameters)
        slope = ca.jacobian(offset, s.x[:n])
        angles = np.pi * np.arange(self.directions) / self.directions
        along = np.round([np.cos(angles), np.sin(angles)], 15).T  # exact zeros
        component = offset + slope @ s.x[n : 2 * n] / self.pole
        if self.answer:
            component += self.answer * s.reference[:2]
        if self.pushed:
            component += s.parameters[self.robot.parameters["push"]]
        return ca.DM(along) @ component


@dataclass(frozen=True)
class JointEffort:
    """What drives a ball robot's arm joints (n) [N m]: torques beyond those that hold the arm at rest in its present pose,
    contacts, payload and estimated disturbance included. Zero in every equilibrium, so that its cost moves none."""

    robot: RobotModel
    groups: Mapping[str, slice] = field(init=False, repr=False)

    reference = 0

    def __post_init__(self) -> None:
        object.__setattr__(self, "groups", {"arm": slice(0, self.size)})

    @property
    def size(self) -> int:
        return len(self.robot.state.groups["arm"])

    def __call__(self, s: Symbols) -> ca.SX:
        base = ball_base(self.robot)
        n = base.nq
        rest, w = ca.SX(n, 1), s.parameters
        net = base.generalized_force(s.x[:n], s.u, w) - base.inverse_dynamics(s.x[:n], rest, rest, w)
        return net[n - self.size :]
